"""A light mesh that looks like a heavy one."""

from .finish import Finished, finish
from .levels import save_levels

__all__ = ["Finished", "finish", "save_levels"]
