"""What the subcommands share: checks of their options."""

from __future__ import annotations

import torch


def chosen_device(name: str) -> torch.device:
    """The device that an option names: "cpu", "cuda", or "auto"; ValueError where CUDA is asked for and missing."""
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda" and not torch.cuda.is_available():
        raise ValueError("--device: expected cpu, got cuda, but torch finds no CUDA device here")
    return torch.device(name)


def checked_count(name: str, value: int, least: int) -> int:
    """``value`` if it is at least ``least``; otherwise ValueError names the option."""
    if value < least:
        raise ValueError(f"--{name.replace('_', '-')}: expected at least {least}, got {value}")
    return value
