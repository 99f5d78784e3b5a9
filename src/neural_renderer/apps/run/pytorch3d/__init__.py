"""The part of PyTorch3D's interface that public programs use, for programs that ``run`` runs without PyTorch3D.

Written from PyTorch3D's documentation: points are rows, multiplied from the right; cameras have x to the left and y up;
images have row 0 at the top and channels last. Drawing, losses and files are those of this package.
"""
