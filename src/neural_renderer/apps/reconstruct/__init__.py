"""Single-image 3D reconstruction: data sets, networks, training and evaluation (sections 4.1 and 5.1 of the paper).

Built on `many` for its data set, and on `view` for --view.
"""
