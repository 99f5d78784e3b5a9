"""`neural-renderer reconstruct`: one picture to a mesh, from data over training and evaluation to prediction."""

from __future__ import annotations

DESCRIPTION = """Turn one picture into a 3D mesh: make data, train a network, measure it, use it.

`neural-renderer reconstruct COMMAND --help` explains each command. From a folder of models to a prediction:

neural-renderer reconstruct dataset models data --splits models/splits.csv

neural-renderer reconstruct train data trained

neural-renderer reconstruct evaluate trained/best.ckpt data

neural-renderer reconstruct predict trained/best.ckpt photo.png -o mesh.obj"""

COMMANDS = {
    name: (name, name.capitalize(), summary)
    for name, summary in {
        "dataset": "Render and voxelise a folder of 3D models.",
        "train": "Train a network, of meshes or of voxels, on pictures alone.",
        "evaluate": "Measure networks as the paper's Table 1 does.",
        "predict": "Turn pictures into meshes with a trained network.",
    }.items()
}
