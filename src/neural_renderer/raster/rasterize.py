"""From the corners of faces in screen space to images: the operations put together, and their public border."""

from __future__ import annotations

import reprlib
from collections.abc import Callable, Collection
from typing import Any, NamedTuple

import torch
from torch import Tensor

from .. import validate
from .ops.barycentrics import barycentrics
from .ops.corners import gather_corners
from .ops.coverage import silhouette
from .ops.downsample import halve
from .ops.texture_cubes import sample_textures
from .settings import Settings
from .visibility.continuity import texture_marks

OUTPUTS = ("rgb", "alpha", "depth")


class Images(NamedTuple):
    """The images of a renderer; None for an output that was not asked for. Row 0 is at the top.

    They may be changed in place before ``backward``.

    Attributes:
        rgb: [B, 3, H, W] float32, the colours.
        alpha: [B, H, W] float32: 1 where a face is seen, 0 elsewhere, in between at anti-aliased outlines.
        depth: [B, H, W] float32, along the viewing axis in world units; ``far`` where no face is seen.
    """

    rgb: Tensor | None = None
    alpha: Tensor | None = None
    depth: Tensor | None = None


def vertices_to_faces(vertices: Tensor, faces: Tensor) -> Tensor:
    """The corners of each face.

    vertices: [B, V, 3] floating. faces: [F, 3] shared by the batch, or [B or 1, F, 3]; whole numbers of any real dtype,
        in [0, V), or (-1, -1, -1) for no face, with which meshes of different size fill up one batch.
    Returns [B, F, 3, 3] float32. Raises TypeError or ValueError for other dtypes, shapes, devices or indices.
    """
    validate.floating("vertices", vertices, ("B", "V", 3))
    faces = checked_faces(faces)
    validate.same_device(vertices=vertices, faces=faces)
    faces = faces[None] if faces.dim() == 2 else faces
    if faces.shape[0] not in (1, vertices.shape[0]):
        raise ValueError(f"faces: expected a batch of {vertices.shape[0]} like vertices, got {faces.shape[0]}")
    validate.in_range("faces", faces, vertices.shape[1], padded=True)
    if faces.dtype == torch.int64:  # an index that is out of range stays so in 32 bits
        faces = faces.clamp(-1, 2**31 - 1)
    return gather_corners(vertices.float(), faces.int())


def world_corners(vertices: Tensor, faces: Tensor, images: int) -> Tensor:
    """The corners of ``vertices`` [V, 3] or [B, V, 3] in the world, where light falls, for so many images.

    Where several cameras see one mesh and there are faces for each of them, the one mesh serves them all.
    """
    vertices = vertices if vertices.dim() == 3 else vertices[None]
    if faces.dim() == 3 and len(faces) == images:
        vertices = vertices.expand(images, -1, -1)
    return vertices_to_faces(vertices, faces)


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
    gradient: str = "nmr",
    triangles: Tensor | None = None,
) -> Images:
    """Draw faces given by their corners in screen space.

    faces: [B, F, 3, 3] floating; corner ``(x, y, z)``: x right and y up in [-1, 1] over the image, z the depth
        along the viewing axis in world units, positive in front of the camera. float64, half and bfloat16 are computed
        in float32.
    size: the images' side, or (height, width), in pixels.
    outputs: which of "rgb", "alpha", "depth"; what is not asked for costs nothing.
    textures: [B or 1, F, T, T, T, 3] floating (T = 1: one colour a face); needed for "rgb".
    light: [B or 1, 2, F, 3] factors for the colour of each face's two sides; none: 1.
    background: colour where no face is seen: a number, [3], [B, 3], or an image [B, 3, H, W] or [3, H, W] (H and W of
        the output).
    near, far: 0 <= near < far; only what has near < depth < far at a pixel is seen.
    eps: added to the distances in the gradient's denominators (screen units); cube coordinates end at T - 1 - eps.
    anti_aliasing: draw at twice the size and average 2 x 2 pixels (colour, alpha and depth alike).
    two_sided: also draw faces whose corners run clockwise on the screen.
    perspective: interpolate depth and texture coordinates in perspective; False for orthographic cameras.
    gradient: the estimator through visibility: "nmr", the paper's (section 3.2), which pulls from afar and whose size
        is not a derivative's; or "edge", the derivative of the image averaged over sub-pixel shifts (see `boundaries`),
        with that of texture coordinates and depth, depth through visibility included.
    triangles: [F, 3] or [B or 1, F, 3] integer, the indices that `vertices_to_faces` made ``faces`` of. With them
        ``"edge"`` finds the neighbours of each face once for a mesh; without, by their corners in each backward.

    Returns Images. An empty batch or mesh gives the background. Raises TypeError or ValueError for anything else.
    """
    settings = Settings.checked(size, near, far, eps, anti_aliasing, two_sided, perspective, gradient)
    outputs = checked_outputs(outputs)
    corners = settings.corners(faces, 1 + 3 * ("rgb" in outputs))
    batch, count = faces.shape[:2]
    device = faces.device
    face_index = settings.face_index(corners)
    depth = None
    layers = {}
    if "depth" in outputs:
        depth = barycentrics(corners, face_index, settings.near, settings.far, perspective)[1]
    if "rgb" in outputs:
        cubes = _checked_textures(textures, batch, count, device)
        factors = _checked_light(light, batch, count, device)
        behind = behind_image(background, batch, 3, settings, device).expand(batch, 3, *face_index.shape[1:])
        inside = corners if gradient == "edge" else corners.detach()  # the derivative inside of faces, too
        layers["rgb"] = sample_textures(cubes, factors, behind, inside, face_index, settings.eps, perspective)
    marks = (lambda: texture_marks(cubes, factors)) if "rgb" in outputs else None
    rings = None
    if triangles is not None:
        rings = settings.rings(corners, _checked_triangles(triangles, faces))
    return finish_images(layers, depth, corners, face_index, settings, outputs, marks, rings)


def finish_images(
    layers: dict[str, Tensor],
    depth: Tensor | None,
    corners: Tensor,
    face_index: Tensor,
    settings: Settings,
    outputs: Collection[str],
    marks: Callable[[], Tensor] | None = None,
    rings: Tensor | None = None,
) -> Images:
    """Images of the ``outputs`` from what is drawn: through visibility, and averaged if they are anti-aliased.

    layers: "rgb", [B, 3, H, W] with the background, if it is among the outputs. depth: [B, H, W], likewise. corners,
        face_index: [B, F, 3, 3] and [B, H, W], which faces were drawn and which of them is seen. marks, rings: see
        `Settings.through_visibility`.
    """
    whole = settings.gradient == "edge"
    if "alpha" in outputs:
        layers["alpha"] = silhouette(face_index)
    if "depth" in outputs and whole:
        layers["depth"] = depth[:, None]  # type: ignore[index]
    rgb = alpha = None
    if layers:
        image = next(iter(layers.values())) if len(layers) == 1 else torch.cat(list(layers.values()), 1)
        colored = "rgb" in outputs
        image = settings.through_visibility(image, corners, face_index, colored, not colored, marks, rings)
        if settings.anti_aliasing:
            image = halve(image)
        # Views where there is one layer: the gradient of a slice is a larger tensor, filled and copied. Copies where
        # there are several, for autograd lets nobody change one of several views in place.
        if len(layers) > 1:
            parts = image.split([layer.shape[1] for layer in layers.values()], 1)
            copies = (part.clone(memory_format=torch.contiguous_format) for part in parts)
            layers = dict(zip(layers, copies, strict=True))
        else:
            layers = dict.fromkeys(layers, image)
        rgb = layers.get("rgb")
        alpha = layers["alpha"].squeeze(1) if "alpha" in layers else None
    if "depth" in layers:
        depth = layers["depth"].squeeze(1)
    elif "depth" not in outputs:
        depth = None
    elif settings.anti_aliasing and depth is not None:
        depth = halve(depth[:, None])[:, 0]
    elif depth is not None and depth.requires_grad:
        depth = depth.clone()  # its gradient needs the values as they are, and callers may change theirs in place
    return Images(rgb, alpha, depth)


def checked_faces(faces: Any) -> Tensor:
    """``faces`` [F, 3] or [B, F, 3] as int32 or int64 (see `validate.indices`); TypeError or ValueError otherwise."""
    return validate.indices("faces", faces, ("F", 3) if getattr(faces, "ndim", 3) == 2 else ("B", "F", 3))


def checked_outputs(outputs: Collection[str]) -> Collection[str]:
    if not isinstance(outputs, Collection) or getattr(outputs, "ndim", 1) != 1:
        raise TypeError(f"outputs: expected some of {', '.join(OUTPUTS)}, got {type(outputs).__name__}")
    names = (outputs,) if isinstance(outputs, str) else tuple(outputs)
    if not names or any(not isinstance(name, str) or name not in OUTPUTS for name in names):
        raise ValueError(f"outputs: expected some of {', '.join(OUTPUTS)}, got {', '.join(map(str, names)) or 'none'}")
    return names


def _checked_triangles(triangles: Any, faces: Tensor) -> Tensor:
    batch, count = faces.shape[:2]
    shape = ("F", 3) if getattr(triangles, "ndim", 3) == 2 else ("B", "F", 3)
    triangles = validate.indices("triangles", triangles, shape)
    if triangles.shape[-2] != count or (triangles.dim() == 3 and len(triangles) not in (1, batch)):
        raise ValueError(
            f"triangles: expected [{count}, 3] or [{batch} or 1, {count}, 3] like faces, "
            f"got {validate.shape_of(triangles)}"
        )
    validate.same_device(faces=faces, triangles=triangles)
    return triangles


def _checked_textures(textures: Any, batch: int, count: int, device: torch.device) -> Tensor:
    if textures is None:
        raise ValueError('textures: expected a tensor [B, F, T, T, T, 3] to draw "rgb", got None')
    validate.cubes("textures", textures, "B", "F")
    validate.same_device(faces=torch.empty(0, device=device), textures=textures)
    if textures.shape[0] not in (1, batch) or textures.shape[1] != count:
        raise ValueError(
            f"textures: expected [{batch} or 1, {count}, T, T, T, 3] like faces, got {validate.shape_of(textures)}"
        )
    validate.finite("textures", textures)
    return textures.float()


def _checked_light(light: Tensor | None, batch: int, count: int, device: torch.device) -> Tensor:
    if light is None:
        return torch.ones((1, 2, count, 3), dtype=torch.float32, device=device)
    validate.floating("light", light, ("B", 2, count, 3))
    validate.same_device(faces=torch.empty(0, device=device), light=light)
    if light.shape[0] not in (1, batch):
        raise ValueError(f"light: expected parameters for {batch} images or for all, got {light.shape[0]}")
    validate.finite("light", light)
    return light.float()


def behind_image(background: Any, batch: int, channels: int, settings: Settings, device: torch.device) -> Tensor:
    """The background as [1 or B, C, 1 or H, 1 or W] float32, H and W at the scale drawn."""
    height, width = settings.height, settings.width
    if not isinstance(background, Tensor):
        try:
            background = torch.as_tensor(background, dtype=torch.float32, device=device)
        except (TypeError, ValueError, RuntimeError, OverflowError):
            raise TypeError(
                f"background: expected a number, a colour [{channels}] or [B, {channels}], or an image, "
                f"got {reprlib.repr(background)}"
            ) from None
    elif background.dtype == torch.uint8:  # an image as it comes from a file, most likely
        raise TypeError(f"background: expected numbers in [0, 1], got {validate.shape_of(background)}")
    validate.dense("background", background)
    if device.type != "meta":
        validate.has_numbers("background", background)
    color = background.to(device=device, dtype=torch.float32)
    validate.finite("background", color)
    color = color.expand(channels) if color.dim() == 0 else color
    shape = tuple(color.shape)
    image = (channels, height, width)
    if shape == (channels,) or (len(shape) == 2 and shape[0] in (1, batch) and shape[1] == channels):
        return color.reshape(-1, channels, 1, 1)
    if shape == image or (len(shape) == 4 and shape[0] in (1, batch) and shape[1:] == image):
        color = color.reshape(-1, *image)
        return color.repeat_interleave(2, 2).repeat_interleave(2, 3) if settings.anti_aliasing else color
    raise ValueError(
        f"background: expected a number, [{channels}], [{batch}, {channels}], {list(image)} or {[batch, *image]}, "
        f"got {list(shape)}"
    )
