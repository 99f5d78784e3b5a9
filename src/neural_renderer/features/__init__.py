"""Networks whose layers serve as features of images: VGG and GoogLeNet, from published checkpoints or from files."""

from .googlenet import googlenet
from .load import PUBLISHED, features_like, load_features
from .network import FeatureNetwork
from .vgg import vgg

__all__ = ["PUBLISHED", "FeatureNetwork", "features_like", "googlenet", "load_features", "vgg"]
