"""`neural-renderer reconstruct`: single-image reconstruction, from data sets to predictions."""

from __future__ import annotations

DESCRIPTION = """Reconstruct a 3D mesh from a single picture: make a data set, train a network, evaluate and use it.

`neural-renderer reconstruct COMMAND --help` explains each command. From a folder of models to a prediction:

neural-renderer reconstruct dataset models data --splits models/splits.csv

neural-renderer reconstruct train data trained

neural-renderer reconstruct evaluate trained/best.ckpt data

neural-renderer reconstruct predict trained/best.ckpt photo.png -o mesh.obj"""

COMMANDS = {
    "dataset": "Render and voxelise a folder of 3D models.",
    "train": "Train a mesh or voxel network from images only.",
    "evaluate": "Evaluate networks like the paper's Table 1.",
    "predict": "Predict meshes from pictures with a trained network.",
}
