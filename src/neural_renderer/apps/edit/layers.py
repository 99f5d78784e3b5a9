"""Default layers of the feature networks. This module does not import torch, so that `--help` starts fast."""

STYLE_LAYERS = ("conv1_2", "conv2_2", "conv3_3", "conv4_3")
"""Layers of VGG for style transfer: the paper's, with conv2_2 in place of conv2_3, which does not exist."""

DREAM_LAYER = "inception_4c"
"""Layer of GoogLeNet for DeepDream: the paper's."""
