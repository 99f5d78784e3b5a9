"""Single-image 3D reconstruction: data sets, networks, training and evaluation (sections 4.1 and 5.1 of the paper)."""
