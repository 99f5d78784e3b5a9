"""Networks whose layers serve as features of images: VGG and GoogLeNet, from published checkpoints or from files."""

from .googlenet import googlenet
from .load import PUBLISHED, load_features
from .network import FeatureNetwork
from .vgg import vgg

__all__ = ["PUBLISHED", "FeatureNetwork", "googlenet", "load_features", "vgg"]
