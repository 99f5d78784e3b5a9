"""Options to follow a run in the browser."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, kw_only=True)
class WatchOptions:
    """Follow the run."""

    view: bool = False
    """Show the mesh in the browser while it changes, with curves, pause, stop and settings. Needs viser: pip install
    'neural-renderer[view]'."""
    host: str = "127.0.0.1"
    """Name or address of this machine to listen on, for --view. Everybody who reaches another address sees the meshes
    and can stop the run."""
    port: int = 8080
    """First port to try, for --view; the next free one is taken. 0: any."""
    record: Path | None = None
    """HTML file that keeps the frames and that any browser opens, without Python."""
    record_limit: float = 32.0
    """Size of that file in MiB at most (at least 1)."""
