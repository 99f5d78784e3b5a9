"""CUDA graphs: what is made while one is captured has no values before a replay, so that nothing of it may be kept."""

from __future__ import annotations

import torch


def capturing(device: torch.device) -> bool:
    """Test whether torch's current stream captures a CUDA graph on a device."""
    return device.type == "cuda" and torch.cuda.is_initialized() and torch.cuda.is_current_stream_capturing()
