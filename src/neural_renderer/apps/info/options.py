"""Options of `neural-renderer info`."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class InfoOptions:
    """Show versions and devices, and check a small image and its gradient on each device.

    Example: neural-renderer info
    """
