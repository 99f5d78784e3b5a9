"""`neural-renderer reconstruct`: single-image reconstruction, from data sets to predictions."""

from __future__ import annotations

from ...commands import Command

DESCRIPTION = """Reconstruct a 3D mesh from a single picture, with the network of the package or with one of your own.

`neural-renderer reconstruct COMMAND --help` explains each command. With the network of the package:

neural-renderer reconstruct predict photo.jpg -o out

From a folder of models to a prediction:

neural-renderer reconstruct dataset models data --splits models/splits.csv

neural-renderer reconstruct train data trained

neural-renderer reconstruct evaluate trained/best.ckpt data

neural-renderer reconstruct predict photo.png -o mesh.obj --checkpoint trained/best.ckpt"""

COMMANDS = {
    "dataset": Command("Render and voxelise a folder of 3D models.", "reconstruct.commands.dataset"),
    "train": Command("Train a mesh or voxel network from images only.", "reconstruct.commands.train"),
    "pretrain": Command("Train the network of the package on generated shapes.", "reconstruct.commands.pretrain"),
    "evaluate": Command("Evaluate networks like the paper's Table 1.", "reconstruct.commands.evaluate"),
    "predict": Command("Predict coloured meshes from pictures.", "reconstruct.commands.predict"),
}
