"""Meshes and scenes of trimesh: vertices, faces and surface colours."""

from __future__ import annotations

import logging
import sys
from typing import Any

import numpy as np

from .files import fits_float32, reason
from .images import unpack
from .surface_colors import SurfaceColors, linear_to_srgb, srgb_to_linear

# trimesh logs a traceback for each missing image. This package warns instead, so the log is not printed by default.
logging.getLogger("trimesh").addHandler(logging.NullHandler())


def is_trimesh(value: Any) -> bool:
    """Test whether a value is a mesh or scene of trimesh, without importing it."""
    kinds = getattr(sys.modules.get("trimesh"), "Trimesh", ()), getattr(sys.modules.get("trimesh"), "Scene", ())
    return isinstance(value, kinds)


def read_trimesh(mesh: Any) -> tuple[np.ndarray, np.ndarray, SurfaceColors | None]:
    """Convert a mesh or scene of trimesh, as `read_mesh` does files; colours are display values."""
    if not is_trimesh(mesh):
        raise TypeError(f"mesh: expected a Trimesh or Scene of trimesh, got {type(mesh).__name__}")
    known: dict[Any, np.ndarray] = {}  # pixels by image and factor
    vertices, faces, surfaces = [], [], []
    offset = 0
    for part, matrix in _parts(mesh):
        order = [0, 2, 1] if np.linalg.det(matrix[:3, :3]) < 0 else [0, 1, 2]  # mirroring turns faces inside out
        corners = np.asarray(part.faces, dtype=np.int64)[:, order]
        with np.errstate(over="ignore", invalid="ignore"):
            points = np.asarray(part.vertices, dtype=np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
        bad = int((~fits_float32(points)).sum())
        if bad:
            raise ValueError(f"mesh: expected finite vertices that float32 can hold, got {bad} bad numbers")
        if len(corners) and (corners.min() < 0 or corners.max() >= len(points)):
            raise ValueError(f"mesh: expected face indices in [0, {len(points)}), got {corners.max()}")
        vertices.append(points)
        faces.append(corners + offset)
        try:
            surfaces.append(_surface(part.visual, corners, known))
        except Exception as error:  # of trimesh and Pillow, for damaged images
            raise ValueError(f"mesh: its colours cannot be read ({reason(error)})") from error
        offset += len(points)
    if not sum(map(len, faces)):
        raise ValueError("mesh: expected at least one face, got none")
    surface = SurfaceColors.joined(surfaces)
    return np.concatenate(vertices), np.concatenate(faces), surface if surface.has_colors else None


def _parts(mesh: Any) -> list[tuple[Any, np.ndarray]]:
    """List the meshes with triangles, and their transforms [4, 4]."""
    import trimesh

    if isinstance(mesh, trimesh.Trimesh):
        return [(mesh, np.eye(4))]
    placed = [(mesh.geometry[name], np.asarray(at)) for at, name in map(mesh.graph.get, mesh.graph.nodes_geometry)]
    return [(part, at) for part, at in placed if isinstance(part, trimesh.Trimesh)]


def _surface(visual: Any, corners: np.ndarray, known: dict[Any, np.ndarray]) -> SurfaceColors:
    """Collect the colours of one mesh with faces ``corners`` [F, 3]."""
    surface = SurfaceColors.plain(len(corners), 1.0)
    kind = visual.kind if visual is not None and visual.defined else None
    surface.has_colors = kind in ("vertex", "face", "texture")
    if kind == "vertex":
        surface.colors[:] = (visual.vertex_colors[:, :3] / 255)[corners]
    elif kind == "face":
        surface.colors[:] = (visual.face_colors[:, :3] / 255)[:, None]
    elif kind == "texture":
        _paint(surface, visual, corners, known)
    return surface


def _paint(surface: SurfaceColors, visual: Any, corners: np.ndarray, known: dict[Any, np.ndarray]) -> None:
    """Set the texture coordinates, and the image or the colour of the material."""
    material = visual.material
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    factor = getattr(material, "baseColorFactor", None)
    factor = np.ones(3) if factor is None else np.asarray(factor, dtype=np.float64)[:3] / 255
    if visual.uv is not None:
        surface.uv[:] = np.where(fits_float32(visual.uv), visual.uv, 0)[corners]
        if image is not None:
            key = (id(image), *factor)
            if key not in known:
                pixels = unpack("its image", image, transparency=False)
                if (factor < 1).any():  # in linear light
                    pixels = linear_to_srgb(srgb_to_linear(pixels) * factor).astype(np.float32)
                known[key] = pixels
            surface.paint(np.arange(len(corners)), known[key], surface.uv.copy())
            return
    if not hasattr(material, "baseColorFactor"):
        factor = np.asarray(material.main_color, dtype=np.float64)[:3] / 255
    surface.colors[:] = factor
