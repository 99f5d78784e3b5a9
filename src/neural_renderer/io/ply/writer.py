"""Writing of binary PLY files with colours of vertices."""

from __future__ import annotations

import numpy as np


def ply_bytes(points: np.ndarray, faces: np.ndarray, colors: np.ndarray | None) -> bytes:
    """Encode vertices [V, 3] float32, faces [F, 3] of whole numbers, and RGBA [V, 4] uint8 or None."""
    place = [(axis, "<f4") for axis in "xyz"]
    color = [] if colors is None else [(name, "u1") for name in ("red", "green", "blue", "alpha")]
    vertices = np.empty(len(points), np.dtype([*place, *color]))
    for names, values in ((place, points), (color, colors)):
        for column, (name, _) in enumerate(names):
            vertices[name] = values[:, column]  # type: ignore[index]
    rows = np.empty(len(faces), np.dtype([("count", "u1"), ("corners", "<i4", 3)]))
    rows["count"], rows["corners"] = 3, faces
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property float {name}" for name, _ in place] + [f"property uchar {name}" for name, _ in color]
    header += [f"element face {len(rows)}", "property list uchar int vertex_indices", "end_header", ""]
    return b"".join(("\n".join(header).encode(), vertices.tobytes(), rows.tobytes()))
