"""CUDA graphs: tensors made during a capture have no values before a replay, so they must not be cached."""

from __future__ import annotations

import torch


def capturing(device: torch.device) -> bool:
    """Test whether torch's current stream captures a CUDA graph on a device."""
    return device.type == "cuda" and torch.cuda.is_initialized() and torch.cuda.is_current_stream_capturing()
