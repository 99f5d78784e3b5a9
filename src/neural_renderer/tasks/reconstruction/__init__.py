"""Single-image 3D reconstruction: from a folder of 3D models to a network that turns one picture into a mesh."""
