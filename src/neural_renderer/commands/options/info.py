"""Options of `neural-renderer info`."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class InfoOptions:
    """Show versions and devices, and check on each device that a small picture and its gradient come out right.

    Example: neural-renderer info
    """
