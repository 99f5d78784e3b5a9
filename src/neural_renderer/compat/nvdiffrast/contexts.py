"""Contexts of `rasterize`. They hold no resources here and exist for programs that create, pass and release them."""

from __future__ import annotations

from typing import Any

from ...base import validate

_log_level = 1


class RasterizeCudaContext:
    """A context of `rasterize`, for any device.

    Args:
        device: Accepted and ignored: operations run where their tensors are.

    Raises:
        TypeError, ValueError: An operation gets an object of another type, or a context that a `DepthPeeler` uses.

    Example:
        >>> import neural_renderer.nvdiffrast as dr
        >>> glctx = dr.RasterizeCudaContext()
    """

    output_db = True

    def __init__(self, device: Any = None) -> None:
        self.peels = False  # a `DepthPeeler` uses it


class RasterizeGLContext(RasterizeCudaContext):
    """A context of `rasterize` under nvdiffrast's name for OpenGL, which is not needed here.

    Args:
        output_db: Whether `rasterize` returns derivatives of the weights; if not, a tensor [B, H, W, 0].
        mode: "automatic", or "manual" for programs that call `set_context` and `release_context`.
        device: Accepted and ignored.

    Raises:
        ValueError: Another mode.

    Example:
        >>> import neural_renderer.nvdiffrast as dr
        >>> glctx = dr.RasterizeGLContext(output_db=False, mode="manual")
        >>> glctx.set_context()
        >>> glctx.release_context()
    """

    def __init__(self, output_db: bool = True, mode: str = "automatic", device: Any = None) -> None:
        super().__init__(device)
        self.output_db = validate.flag("output_db", output_db)
        if mode not in ("automatic", "manual"):
            raise ValueError(f"mode: expected 'automatic' or 'manual', got {mode!r}")

    def set_context(self) -> None:
        """Do nothing; there is no OpenGL context to make current."""

    def release_context(self) -> None:
        """Do nothing, as `set_context`."""


def free_context(glctx: Any) -> RasterizeCudaContext:
    """Return ``glctx`` if it is a context that no `DepthPeeler` uses; raise TypeError or ValueError otherwise."""
    if not isinstance(glctx, RasterizeCudaContext):
        raise TypeError(f"glctx: expected a RasterizeCudaContext or RasterizeGLContext, got {type(glctx).__name__}")
    if glctx.peels:
        raise ValueError("glctx: expected a context that no DepthPeeler uses; make another one inside its block")
    return glctx


def get_log_level() -> int:
    """Return the level of messages to print.

    Returns:
        The number that `set_log_level` has set; 1 at first.

    Example:
        >>> import neural_renderer.nvdiffrast as dr
        >>> dr.get_log_level()
        1
    """
    return _log_level


def set_log_level(level: int) -> None:
    """Set the level of messages to print: 0 information, 1 warnings, 2 errors, 3 fatal errors.

    Stored for `get_log_level` only; nothing is logged.

    Args:
        level: Whole number from 0 to 3.

    Raises:
        TypeError, ValueError: Another number.

    Example:
        >>> import neural_renderer.nvdiffrast as dr
        >>> dr.set_log_level(1)
    """
    global _log_level
    if validate.whole("level", level, 0) > 3:
        raise ValueError(f"level: expected 0 to 3, got {level}")
    _log_level = level
