"""Rasterisation of faces in screen space into colour, silhouettes and depth."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import torch
from torch import Tensor

from ..base import validate
from .ahead import CUBES, load_kernels
from .cube_colors import checked_colors, cube_colors
from .depth_limits import tell_what_is_too_far
from .exact import checked_dtype, exact_images
from .faces import checked_triangles
from .outputs import OUTPUTS, Images, checked_outputs
from .settings import Settings
from .visibility.estimators import Estimator
from .visible import VisibleFaces


@validate.checked_together
def rasterize_images(
    faces: Tensor,
    size: int | tuple[int, int],
    *,
    outputs: Collection[str] = OUTPUTS,
    textures: Tensor | None = None,
    light: Tensor | None = None,
    background: Any = (0.0, 0.0, 0.0),
    near: float = 0.1,
    far: float = 100.0,
    eps: float = 1e-4,
    anti_aliasing: bool = True,
    two_sided: bool = False,
    perspective: bool = True,
    gradient: str | Estimator = "edge",
    triangles: Tensor | None = None,
    dtype: torch.dtype = torch.float32,
) -> Images:
    """Draw faces given by their corners in screen space.

    Args:
        faces: Corners (x, y, z), [B, F, 3, 3] floating: x right and y up in [-1, 1] over the image, z the depth along
            the viewing axis in world units, positive in front of the camera. Computed in ``dtype``.
        size: Side of the images, or (height, width), in pixels.
        outputs: Some of "rgb", "alpha", "depth". Other outputs are not computed.
        textures: Cubes [B or 1, F, T, T, T, 3] floating (T = 1: one colour per face), or colours of the faces' corners
            [B or 1, F, 3, 3] floating. Needed for "rgb".
        light: Factors [B or 1, 2, F, 3] on the front and the back of each face; None for 1.
        background: Number, colour [3] or [B, 3], or image [3, H, W] or [B, 3, H, W] of the returned size.
        near, far: Depth range, 0 <= near < far; a point is visible if near < depth < far.
        eps: Added to distances in the denominators of ``"nmr"``, in screen units; cube coordinates end at T - 1 - eps.
        anti_aliasing: Draw at twice the size and average 2 x 2 pixels of all outputs.
        two_sided: Draw also faces whose corners run clockwise on the screen.
        perspective: Interpolate depth and texture coordinates in perspective; False for orthographic cameras.
        gradient: Estimator of the gradient through visibility. ``"edge"`` is the derivative of the image averaged over
            sub-pixel shifts, including the derivatives of texture coordinates and depth. ``"nmr"`` is the paper's
            approximation (section 3.2): it also acts over long distances, and its magnitude is not a derivative's.
            ``"opendr"`` is OpenDR's (Loper and Black, 2014), by differences of neighbouring pixels: for comparison.
        triangles: Vertex indices of ``faces``, [F, 3] or [B or 1, F, 3] integer, as given to `vertices_to_faces`. With
            them ``"edge"`` finds adjacent faces once per mesh. Without them, it searches for adjacent faces by the
            positions of corners in every backward pass.
        dtype: Of the images. float64 computes in plain torch: all derivatives with respect to textures, light and
            background, of any order and in any mode, as `torch.autograd.gradcheck` needs them, but many times slower,
            and none with respect to ``faces``. The visible faces are those of float32.

    Returns:
        Images. An empty batch or mesh gives the background.

    Raises:
        TypeError: An argument of another type.
        ValueError: An argument of another shape, device or range.
        RuntimeError: In backward, a gradient to ``faces`` in float64, or a second derivative that needs one.

    Example:
        >>> corners = nr.vertices_to_faces(*[part[None] for part in nr.icosphere(1)])
        >>> nr.rasterize_images(corners + torch.tensor([0.0, 0.0, 3.0]), 32, outputs="alpha").alpha.shape
        torch.Size([1, 32, 32])
    """
    settings = Settings.checked(size, near, far, eps, anti_aliasing, two_sided, perspective, gradient)
    outputs, dtype = checked_outputs(outputs), checked_dtype(dtype)
    corners = settings.corners(faces, 1 + 3 * ("rgb" in outputs))
    tell_what_is_too_far(corners, settings.far)
    load_kernels(settings, outputs, CUBES, corners)
    face_index = settings.face_index(corners)
    half_edges = None if triangles is None else settings.half_edges(corners, checked_triangles(triangles, corners))
    visible = VisibleFaces(corners, face_index, settings, half_edges)
    if dtype == torch.float64:
        colors = checked_colors(visible, textures, light, background, dtype) if "rgb" in outputs else ()
        return exact_images(visible, faces, outputs, *colors)
    if "rgb" not in outputs:
        return visible.images(outputs)
    return visible.images(outputs, *cube_colors(visible, textures, light, background))
