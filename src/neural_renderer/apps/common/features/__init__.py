"""Image features of pretrained networks: VGG and GoogLeNet, downloaded or read from a file."""

from .googlenet import googlenet
from .load import PUBLISHED, features_like, load_features
from .network import FeatureNetwork
from .vgg import vgg

__all__ = ["PUBLISHED", "FeatureNetwork", "features_like", "googlenet", "load_features", "vgg"]
