"""Pictures of `Images`, `Fragments`, `Mesh` and `UVMesh` in notebooks.

A notebook calls the method ``_repr_png_`` of an object to show it. The package adds the method to the classes, which
are below this module in the order of imports; it calls `png_of`.
"""

from __future__ import annotations

import io
from collections.abc import Sequence

import torch
import torch.nn.functional as F
from PIL import Image
from torch import Tensor

from ....meshes.mesh import Mesh
from ....meshes.uv_mesh import UVMesh
from ....raster import Images
from ....raster.fragments import Fragments
from .photograph import turntable

_MOST_IMAGES = 8  # most images shown of a batch
_LEAST_SIDE, _MOST_WIDTH = 128, 1024  # pixels: small images are enlarged, wide rows are reduced
_FRAMES, _FRAME_SIZE, _FRAME_MILLISECONDS = 20, 192, 120
_MANY_FACES = 200_000  # a turntable of a larger mesh would take many seconds; one picture is shown instead


def png_of(shown: Images | Fragments | Mesh | UVMesh) -> bytes | None:
    """Draw an object as a PNG file; None for one without a picture."""
    if isinstance(shown, Images):
        return images_png(shown)
    return fragments_png(shown) if isinstance(shown, Fragments) else mesh_png(shown)


@torch.no_grad()
def images_png(images: Images) -> bytes | None:
    """Draw the first images of a batch: a row of colours, a row of silhouettes, a row of depth (near is white).

    Returns a PNG file, or None for a batch without pixels; the notebook then shows text.
    """
    rows = []
    rgb, alpha, depth = images
    if rgb is not None:
        rows.append(rgb[:_MOST_IMAGES])
    if alpha is not None:
        rows.append(alpha[:_MOST_IMAGES, None].expand(-1, 3, -1, -1))
    if depth is not None:
        rows.append(_nearness(depth[:_MOST_IMAGES])[:, None].expand(-1, 3, -1, -1))
    return _png([_rows_side_by_side(rows)]) if rows and rows[0].numel() else None


@torch.no_grad()
def fragments_png(fragments: Fragments) -> bytes | None:
    """Draw maps of the visible faces, a colour per face, on white. Returns None for a batch without pixels."""
    index = fragments.face_index[:_MOST_IMAGES]
    if not index.numel():
        return None
    # Multiples of the golden ratio give consecutive faces different hues.
    hue = torch.frac(index.double() * 0.6180339887)[:, None] * 6 + torch.tensor([0.0, 4.0, 2.0]).view(3, 1, 1).to(index)
    color = ((hue % 6 - 3).abs() - 1).clamp(0, 1) * 0.55 + 0.35
    color = torch.where(index[:, None] >= 0, color, 1.0).float()
    return _png([_rows_side_by_side([color[..., :: fragments.settings.scale, :: fragments.settings.scale]])])


def mesh_png(mesh: Mesh | UVMesh) -> bytes | None:
    """Draw a turntable as an animated PNG, or one picture of a very fine mesh. Returns None for a mesh of no extent."""
    try:
        mesh = mesh.normalize()
    except ValueError:
        return None
    frames = _FRAMES if len(mesh.faces) <= _MANY_FACES else 1
    return _png(list(turntable(mesh, frames, 180, size=_FRAME_SIZE)))


def _nearness(depth: Tensor) -> Tensor:
    """Convert depth [B, H, W] to grey: 1 for the nearest surface, about 0.2 for the farthest, 0 for background."""
    depth = depth.nan_to_num(posinf=0.0)
    covered = depth[depth < 0.9 * depth.amax()]
    if not covered.numel():  # one depth everywhere: a surface that fills the image, or none
        covered = depth.flatten()
    # Anti-aliasing mixes the background's depth into outlines; outlines are fewer than a fifth of the pixels.
    low, typical = covered.min(), covered.sort().values[len(covered) * 4 // 5]
    grey = 1 - 0.64 * (depth - low) / (typical - low).clamp(min=1e-6)
    return grey.clamp(min=0)


def _rows_side_by_side(rows: Sequence[Tensor]) -> Tensor:
    """Arrange rows of images [B, 3, H, W] in one picture [3, H', W'], enlarged or reduced to a comfortable size."""
    whole = torch.cat([torch.cat(list(row), dim=2) for row in rows], dim=1).float()[None]
    enlarged = max(min(-(-_LEAST_SIDE // rows[0].shape[2]), _MOST_WIDTH // whole.shape[3]), 1)
    if enlarged > 1:
        whole = whole.repeat_interleave(enlarged, 2).repeat_interleave(enlarged, 3)
    elif whole.shape[3] > _MOST_WIDTH:
        height = max(whole.shape[2] * _MOST_WIDTH // whole.shape[3], 1)
        whole = F.interpolate(whole, (height, _MOST_WIDTH), mode="area")
    return whole[0]


def _png(frames: Sequence[Tensor]) -> bytes:
    """Encode pictures [3, H, W] in [0, 1] as a PNG file, animated if there are several."""
    pixels = [(frame.nan_to_num().clamp(0, 1) * 255).round().byte().permute(1, 2, 0).cpu().numpy() for frame in frames]
    first, *others = [Image.fromarray(array) for array in pixels]
    file = io.BytesIO()
    if others:
        # One palette for all frames: a third of the size, and no flicker from frame to frame.
        palette = first.quantize(256, dither=Image.Dither.NONE)
        first, *others = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in (first, *others)]
        first.save(file, "PNG", save_all=True, append_images=others, duration=_FRAME_MILLISECONDS, loop=0)
    else:
        first.save(file, "PNG")
    return file.getvalue()
