"""A light mesh that looks like a heavy one."""

from .finish import Finished, finish

__all__ = ["Finished", "finish"]
