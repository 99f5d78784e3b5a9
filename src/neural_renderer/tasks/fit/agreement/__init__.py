"""Agreement of masks and cameras, and what mends them if they disagree."""

from .check import check_agreement

__all__ = ["check_agreement"]
