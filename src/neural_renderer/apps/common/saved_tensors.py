"""Files of torch.save, read without running code from them."""

from __future__ import annotations

import os
import warnings
import zipfile
from typing import Any

import torch

_LONGEST = 200  # characters of a message of torch


def load_tensors(path: str | os.PathLike[str], device: torch.device | str = "cpu") -> Any:
    """Load tensors and plain values from a file of torch.save, without running code from it; see `why_not_loaded`."""
    if zipfile.is_zipfile(path):  # torch.save does not compress, and a compressed file could fill the memory
        with zipfile.ZipFile(path) as archive:
            if sum(member.file_size for member in archive.infolist()) > os.path.getsize(path):
                raise ValueError("it is compressed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torch asks users of files that it refuses to report them
        return torch.load(path, map_location=device, weights_only=True)


def why_not_loaded(error: Exception) -> str:
    """Explain why torch.load failed. Its own message advises to load the file unsafely."""
    words = str(error).strip()
    if "unsupported global" in words.lower() or "unsupported class" in words.lower():
        return "it holds Python objects that could run code"
    if "Weights only load failed" in words or isinstance(error, (LookupError, EOFError)):
        return "unknown format"
    return words.partition(". ")[0].splitlines()[0][:_LONGEST] if words else type(error).__name__
