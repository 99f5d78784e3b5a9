"""Surface of a mesh as the viewer shows it: its colours, one colour, its normals, or a colour for each face.

This is written in numpy, on one core: torch's threads would compete with the task's threads.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np
from PIL import Image
from torch import Tensor

from ....io.surface_colors import linear_to_srgb, srgb_to_linear
from ....meshes.uv_mesh import UVMesh
from ...common.pictures.clay import CLAY
from .glb import Drawable
from .snapshot import Memo, Snapshot

Surface = Literal["colours", "clay", "normals", "faces"]
SURFACES: tuple[Surface, ...] = ("colours", "clay", "normals", "faces")
_MOST_ATLAS_PIXELS = 4096**2  # largest atlas in pixels; finer meshes get colours at corners only
_LARGEST_IMAGE = 4096  # longer side of an image in pixels
_EVEN = 2  # difference, of 255, below which colours count as one
_FEW = 64  # faces tested first, for speed
_V_DOWN, _V_TOP = np.array([1, -1], np.float32), np.array([0, 1], np.float32)  # factor and offset from v up to v down
_JPEGS: Memo[bytes] = Memo()


@dataclass(frozen=True)
class Look:
    """Settings of the display of meshes."""

    surface: Surface = "colours"  # "normals" are in world space, "faces" have a colour each
    lit: bool = True  # "normals" never are
    smooth: bool = True  # light is interpolated over faces that share vertices


_UNLIT = Look(lit=False)


def drawables(snapshot: Snapshot, look: Look, values: Tensor | None = None) -> list[Drawable]:
    """Convert a mesh of finite vertices, with a face, to arrays for a graphics card: a part for each image.

    ``values`` [V, 3] in [0, 1] are colours of vertices to show in place of the surface.
    """
    vertices, faces = snapshot.vertices.numpy(), snapshot.faces.numpy()
    if values is not None:
        return [_of_vertices(vertices, faces, _bytes(values.numpy()), Look(lit=look.lit))]
    if look.surface == "normals":
        if look.smooth:
            return [_of_vertices(vertices, faces, _bytes((vertex_normals(vertices, faces) + 1) / 2), _UNLIT)]
        normals = _bytes((_unit(_face_normals(vertices, faces)) + 1) / 2)
        return [_of_corners(vertices, faces, normals[:, None].repeat(3, 1), _UNLIT)]
    if look.surface == "faces":
        colors = _bytes(face_colors(np.arange(len(faces))))
        return [_of_corners(vertices, faces, colors[:, None].repeat(3, 1), look)]
    if look.surface == "clay" or (snapshot.uv_mesh is None and snapshot.textures is None):
        return [_plain(vertices, faces, CLAY, look)]
    if snapshot.uv_mesh is not None:
        return _of_images(vertices, faces, snapshot.uv_mesh, look)
    return [_of_cubes(vertices, faces, snapshot.textures.numpy(), look)]  # type: ignore[union-attr]


def face_colors(index: np.ndarray) -> np.ndarray:
    """Choose colours [F, 3] for numbers of faces [F]; consecutive numbers get different hues."""
    hue = (index * 0.6180339887 % 1)[:, None] * 6 + np.array([0.0, 4.0, 2.0])  # golden ratio
    return (np.abs(hue % 6 - 3) - 1).clip(0, 1) * 0.55 + 0.35


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Compute area-weighted normals of vertices, [V, 3] float32."""
    normals = _face_normals(vertices, faces).repeat(3, 0)
    places, count = faces.reshape(-1), len(vertices)
    sums = [np.bincount(places, normals[:, axis], count) for axis in range(3)]
    return _unit(np.stack(sums, 1)).astype(np.float32)


def _of_cubes(vertices: np.ndarray, faces: np.ndarray, cubes: np.ndarray, look: Look) -> Drawable:
    """Convert texture cubes to one colour, corner colours, or an atlas."""
    count, size = cubes.shape[:2]
    used, corners = _plane(size)
    texels = _bytes(cubes.reshape(count, -1, 3).take(used, 1))
    if _is_even(texels[:_FEW].reshape(1, -1, 3)) and _is_even(texels.reshape(1, -1, 3)):
        red, green, blue = (float(value) for value in texels[0, 0] / 255)
        return _plain(vertices, faces, (red, green, blue), look)
    width = size + 2
    is_flat = _is_even(texels[:_FEW]) and _is_even(texels)
    if size <= 2 or is_flat or count * width**2 > _MOST_ATLAS_PIXELS:
        colors = texels[:, corners]
        shared = np.zeros((len(vertices), 3), np.uint8)
        shared[faces.reshape(-1)] = colors.reshape(-1, 3)
        if look.smooth and (np.abs(shared[faces].astype(np.int16) - colors) < _EVEN).all():
            return _of_vertices(vertices, faces, shared, look)
        return _of_corners(vertices, faces, colors, look)
    columns = int(np.ceil(np.sqrt(count)))
    rows = -(-count // columns)
    tiles = np.zeros((rows * columns, width, width, 3), np.uint8)
    tiles[:count] = texels.take(_tile(size), 1)
    picture = tiles.reshape(rows, columns, width, width, 3).swapaxes(1, 2).reshape(rows * width, columns * width, 3)
    number = np.arange(count)
    first = np.stack((number % columns, number // columns), 1)[:, None] * width + 1.5
    places = first + (size - 1) * np.array([[0, 0], [1, 0], [0, 1]])
    uv = (places / [columns * width, rows * width]).astype(np.float32).reshape(-1, 2)
    return Drawable(vertices, faces.reshape(-1), uv=uv, image=_jpeg(picture), wrap="clamp", lit=look.lit)


def _is_even(texels: np.ndarray) -> bool:
    """Return whether each of several surfaces [N, T, 3] has one colour."""
    channels = (np.ascontiguousarray(texels[..., channel]) for channel in range(3))  # numpy reduces long rows fast
    return all((channel.max(1) - channel.min(1) < _EVEN).all() for channel in channels)


@lru_cache(maxsize=16)
def _plane(size: int) -> tuple[np.ndarray, np.ndarray]:
    """List the texels of a cube [T, T, T] in the plane of the face, and which of them are its corners."""
    last = size - 1
    i, j, k = (axis.reshape(-1) for axis in np.indices((size,) * 3))
    used = np.flatnonzero(i + j + k == last)
    corners = [int(np.flatnonzero(used == place)[0]) for place in (last * size * size, last * size, last)]
    return used, np.array(corners)


@lru_cache(maxsize=16)
def _tile(size: int) -> np.ndarray:
    """Choose the texel of each pixel of a tile [T + 2, T + 2]: a right triangle, and its surroundings for blending."""
    used, _ = _plane(size)
    rank = {int(place): number for number, place in enumerate(used)}
    pixels = np.zeros((size + 2, size + 2), np.int64)
    for y in range(size + 2):
        for x in range(size + 2):
            j, k = (min(max(value - 1, 0), size - 1) for value in (x, y))
            beyond = max(j + k - (size - 1), 0)
            j, k = max(j - (beyond + 1) // 2, 0), max(k - beyond // 2, 0)
            pixels[y, x] = rank[(size - 1 - j - k) * size * size + j * size + k]
    return pixels


def _of_images(vertices: np.ndarray, faces: np.ndarray, mesh: UVMesh, look: Look) -> list[Drawable]:
    """Show the images of a mesh, and the corner colours of faces without an image; unlit materials without light."""
    unlit = _unlit_faces(mesh) if look.lit else np.zeros(len(faces), bool)
    found = _of_lit_images(vertices, faces, mesh, look, ~unlit)
    return found + (_of_lit_images(vertices, faces, mesh, replace(look, lit=False), unlit) if unlit.any() else [])


def _unlit_faces(mesh: UVMesh) -> np.ndarray:
    """Test which faces have an unlit material, [F]."""
    flags = np.array([*(material.unlit for material in mesh.materials), False])
    index = np.zeros(mesh.num_faces, np.int64) if mesh.material_index is None else mesh.material_index.numpy()
    return flags[index]


def _of_lit_images(
    vertices: np.ndarray, faces: np.ndarray, mesh: UVMesh, look: Look, chosen: np.ndarray
) -> list[Drawable]:
    found = []
    index = mesh.image_index.numpy()
    tints = None if mesh.tints is None else mesh.tints.numpy()[..., :3]
    for number, (image, wrap) in enumerate(zip(mesh.images, mesh.wraps, strict=True)):
        of_image = np.flatnonzero((index == number) & chosen)
        if not len(of_image):
            continue
        uv = np.nan_to_num(mesh.uv.numpy()[of_image].reshape(-1, 2) * _V_DOWN + _V_TOP)
        corners = faces[of_image].reshape(-1)
        order = normals = colors = None
        if tints is not None:
            colors = _bytes(linear_to_srgb(tints[of_image].reshape(-1, 3).clip(0, 1)))
            normals = vertex_normals(vertices, faces) if look.smooth else None
        elif look.smooth:
            # A vertex of a graphics card has one texture coordinate, so a vertex with several is duplicated.
            first, inverse = _seams(corners, uv)
            normals = vertex_normals(vertices, faces)
            corners, uv, order = corners[first], uv[first], inverse.reshape(-1, 3).astype(np.uint32)
        picture = _JPEGS.get(image, lambda image: _jpeg(_bytes(image.numpy())))
        drawn = Drawable(
            vertices, corners, normals, order, colors=colors, uv=uv, image=picture, wrap=wrap, lit=look.lit
        )
        found.append(drawn)
    rest = (index < 0) & chosen
    if rest.any():
        shown = mesh.colors.numpy()[rest]
        if tints is not None:
            shown = linear_to_srgb(srgb_to_linear(shown.clip(0, 1)) * tints[rest].clip(0, 1))
        found.append(_of_corners(vertices, faces[rest], _bytes(shown), look))
    return found


def _seams(corners: np.ndarray, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find equal pairs (vertex, coordinates): the first pair of each kind, and the kind of each pair."""
    order = np.lexsort((uv[:, 1], uv[:, 0], corners))
    is_new = np.ones(len(order), bool)
    is_new[1:] = (np.diff(corners[order]) != 0) | (np.diff(uv[order], axis=0) != 0).any(1)
    inverse = np.empty(len(order), np.int64)
    inverse[order] = np.cumsum(is_new) - 1
    return order[is_new], inverse


def _plain(vertices: np.ndarray, faces: np.ndarray, color: tuple[float, float, float], look: Look) -> Drawable:
    if look.smooth or look.lit:  # the browser shades a single colour itself
        return Drawable(vertices, index=faces.astype(np.uint32), color=color, lit=look.lit)
    return Drawable(vertices, faces.reshape(-1), color=color, lit=look.lit)


def _of_vertices(vertices: np.ndarray, faces: np.ndarray, colors: np.ndarray, look: Look) -> Drawable:
    """Show colours of vertices, [V, 3] uint8."""
    if not look.smooth:
        return _of_corners(vertices, faces, colors[faces], look)
    normals = vertex_normals(vertices, faces) if look.lit else None
    return Drawable(vertices, None, normals, faces.astype(np.uint32), colors=colors, lit=look.lit)


def _of_corners(vertices: np.ndarray, faces: np.ndarray, colors: np.ndarray, look: Look) -> Drawable:
    """Show colours of the faces' corners, [F, 3, 3] uint8."""
    return Drawable(vertices, faces.reshape(-1), colors=colors.reshape(-1, 3), lit=look.lit)


def _face_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Compute normals of faces, [F, 3], twice as long as the area."""
    first, second, third = (vertices[faces[:, corner]] for corner in range(3))
    (ax, ay, az), (bx, by, bz) = (second - first).T, (third - first).T
    return np.stack((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx), 1)


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Scale vectors to length 1; 0 stays 0."""
    return vectors / np.maximum(np.sqrt((vectors * vectors).sum(1, keepdims=True)), 1e-30)


def _bytes(colors: np.ndarray) -> np.ndarray:
    return (np.minimum(np.fmax(colors, 0), 1) * 255 + 0.5).astype(np.uint8)  # fmax turns NaN to 0


def _jpeg(pixels: np.ndarray) -> bytes:
    """Encode an image, with colours at full resolution, reduced if it is very large."""
    picture, file = Image.fromarray(pixels), io.BytesIO()
    if max(picture.size) > _LARGEST_IMAGE:
        picture.thumbnail((_LARGEST_IMAGE, _LARGEST_IMAGE))
    picture.save(file, "JPEG", quality=92, subsampling=0)
    return file.getvalue()
