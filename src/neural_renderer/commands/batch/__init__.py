"""`neural-renderer batch`: many runs of `fit`, `style` or `dream`, one for each row of a table."""

from .run import run

__all__ = ["run"]
