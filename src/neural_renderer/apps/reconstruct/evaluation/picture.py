"""A coloured mesh from one picture, with the network that the package ships."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ....base import validate
from ....compat.first_packages.adam import Adam
from ....io import load_image
from ....meshes.mesh import Mesh
from ....meshes.normals import vertex_normals
from ....optim.losses import silhouette_iou_loss
from ....rendering.forward import render
from ...common.masks.rule import box_mask
from ..data.framing import SIZE
from ..networks.shape_network import ShapeNetwork, outline_iou
from ..shapes.shapes import CLASSES
from ..shapes.views import camera_points, clip_points, crop
from .cutout import cut_out
from .familiarity import LEAST_FAMILIAR, evidence, shipped_calibration
from .predict import voxel_mesh

WEIGHTS = Path(__file__).parents[1] / "networks" / "shape_network.pt"
"""The shipped weights, in half precision."""

STEPS = 30
_THRESHOLDS = (0.5, 0.4, 0.3)  # of probabilities: thin parts need a lower one
_LATTICE = 7  # control points of the deformation along each axis
_RATE, _STIFF = 0.01, 0.3  # step of Adam, and weight of the bend
_BETAS = (0.7, 0.9)  # of Adam: few steps, so short memories
_DETAIL = 160  # side of the crop that colours the mesh, in pixels
LEAST_OUTLINE = 0.7
"""IoU of a mesh's outline and the picture's below which the mesh is doubtful."""
_INSIDE = 0.9  # mask value above which a pixel shows only the object
_ROUNDING = 0.02  # of the drawn depth, relative to its range
_NORMAL = 0.15  # distance that a difference of normals counts as, for colours of hidden vertices
_NEARER = 0.02  # a vertex takes the colours of the mirror image if it is nearer to it by this
_BEHIND = 0.03  # depth by which a visible vertex may lie behind the drawn surface


@dataclass(frozen=True)
class Reconstruction:
    """Result of `reconstruct`.

    Attributes:
        mesh: Mesh with vertex colours, y up and the front at +z; its longest side is about 1.
        category: The likeliest category.
        probabilities: Category → probability, given that the object is of one of the categories.
        outline: IoU of the mesh's outline with the object's in the picture.
        cutout: The object as the network saw it, RGBA [4, 64, 64] in [0, 1].
        pose: View of the picture, [6] (``shapes/views.py`` explains the numbers).
        familiar: Probability that the object is of one of the categories; None for other networks than the shipped one.
            Where half of the pictures show other objects, it is calibrated.

    Example:
        >>> picture = torch.rand(64, 64, 4)
        >>> nr.reconstruct(picture, mask=torch.eye(64).cumsum(0), steps=0).cutout.shape
        torch.Size([4, 64, 64])
    """

    mesh: Mesh
    category: str
    probabilities: dict[str, float]
    outline: float
    cutout: Tensor
    pose: Tensor
    familiar: float | None = None

    @property
    def doubts(self) -> tuple[str, ...]:
        """Reasons why the mesh is doubtful, as sentences; empty if there are none."""
        found = []
        if self.familiar is not None and self.familiar < LEAST_FAMILIAR:
            found.append(
                f"this looks like none of the {len(CLASSES)} kinds of objects that the network knows (probability that "
                f"it is one: {self.familiar:.0%}); its mesh is a guess, nearest to {self.category}"
            )
        if self.outline < LEAST_OUTLINE:
            found.append(
                f"the outline of the mesh agrees with the picture to an IoU of {self.outline:.2f} only, expected "
                f"{LEAST_OUTLINE}; a mask or a box may help"
            )
        return tuple(found)

    @property
    def verdict(self) -> Literal["good", "doubtful"]:
        """The verdict in a word: "doubtful" if there are `doubts`."""
        return "doubtful" if self.doubts else "good"


@cache
def shipped_network() -> ShapeNetwork:
    """Load the network that the package ships; it is frozen."""
    return load_shape_network(WEIGHTS)


def load_shape_network(path: str | os.PathLike[str]) -> ShapeNetwork:
    """Load a network from the weights that `pretrain` writes. Raises ValueError for other files."""
    from ....io.files import existing
    from ...common.saved_tensors import load_tensors, why_not_loaded

    network = ShapeNetwork()
    try:
        content = load_tensors(existing(path, "weights"))
    except FileNotFoundError:
        raise
    except Exception as error:  # torch raises errors of many classes, and advises to load the file unsafely
        raise ValueError(f"{path}: expected weights of a shape network ({why_not_loaded(error)})") from None
    try:
        network.load_state_dict(content["weights"])
    except (KeyError, TypeError, RuntimeError):
        raise ValueError(f"{path}: expected weights of a shape network, got others") from None
    return network.float().eval().requires_grad_(False)


def reconstruct(
    image: str | os.PathLike[str] | Tensor | np.ndarray,
    mask: Tensor | None = None,
    *,
    box: tuple[float, float, float, float] | None = None,
    azimuth: float | None = None,
    steps: int = STEPS,
    network: ShapeNetwork | None = None,
    observe: Callable[[int, float], Any] | None = None,
) -> Reconstruction:
    """Reconstruct a coloured mesh from one picture of an object.

    The object is what the mask or the alpha channel shows; in an opaque picture, what differs from a plain background;
    with ``box``, what differs from the colours outside of the box. A network predicts category, view and voxels; their
    surface is deformed until its outline agrees with the picture, and takes its colours from it. Hidden sides take the
    colours of the mirrored side, or of the nearest visible one.

    The network knows 13 kinds of objects: airplanes, beds, benches, blasters (toy guns), cabinets, cars, chairs,
    displays, lamps, rifles, sofas, tables and watercraft. Others become the nearest shape, which is a guess:
    `Reconstruction.verdict` is "doubtful" for most of them.

    Args:
        image: Picture file, or picture [H, W, 3 or 4] in [0, 1], as `load_image` returns it, or uint8.
        mask: [H, W] in [0, 1], 1 on the object.
        box: Left, top, right and bottom of a box around the object, as shares of width and height in [0, 1].
        azimuth: Direction from which the picture was taken, in degrees, as of `get_points_from_angles`: 180 is in
            front of the object, at +z, 90 at +x, 0 behind it; None to predict it.
        steps: Steps of the refinement.
        network: Network; by default the shipped one.
        observe: Called after each step with its number and the loss; the refinement ends when it returns False.

    Returns:
        The reconstruction.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: The picture or the mask has another shape or numbers that are not finite; the picture shows no
            object; the azimuth is not finite, or the steps are negative.

    Example:
        >>> picture = torch.ones(96, 96, 3)
        >>> picture[30:60, 20:80] = torch.tensor([0.6, 0.2, 0.1])
        >>> result = nr.reconstruct(picture, steps=2)
        >>> result.mesh.vertex_colors.shape == result.mesh.vertices.shape
        True
        >>> result.verdict in ("good", "doubtful")
        True
    """
    picture = load_image(image, upright=True) if isinstance(image, (str, os.PathLike)) else torch.as_tensor(image)
    if picture.ndim != 3 or picture.shape[2] not in (3, 4):
        raise ValueError(f"image: expected a picture [H, W, 3 or 4], got {validate.shape_of(picture)}")
    picture = picture.float() / 255 if picture.dtype == torch.uint8 else picture.float()
    validate.finite("image", picture)
    if azimuth is not None:
        validate.number("azimuth", azimuth)
    validate.whole("steps", steps, 0)
    if mask is not None:
        mask = torch.as_tensor(mask).float()
        if mask.ndim != 2:
            raise ValueError(f"mask: expected [H, W], got {validate.shape_of(mask)}")
        validate.finite("mask", mask)
    if mask is None and box is not None:
        mask = box_mask(picture, box)
    rgba = cut_out(picture, mask)[None]
    network = shipped_network() if network is None else network
    images = crop(rgba)[0]
    occupancy, pose, threshold, shares = _predict(network, images, azimuth)
    familiar = None
    if network is shipped_network():
        familiar = float(shipped_calibration().familiar(evidence(network, images, occupancy, pose)))
        shares = shipped_calibration().categories(shares)
    vertices, faces = voxel_mesh(occupancy[0], threshold)
    vertices, pose = fit_outline(vertices, faces, images, pose, steps, observe)
    colors = picture_colors(vertices, faces, crop(rgba, size=_DETAIL)[0], pose)
    drawn = render((clip_points(vertices, pose), faces), None, SIZE, outputs="alpha").alpha
    outline = 1 - float(silhouette_iou_loss(drawn, images[:, 3]))
    probabilities = dict(zip(CLASSES, shares.tolist(), strict=True))
    category = max(probabilities, key=probabilities.__getitem__)
    return Reconstruction(
        Mesh(vertices, faces, vertex_colors=colors), category, probabilities, outline, images[0], pose[0], familiar
    )


@torch.no_grad()
def _predict(network: ShapeNetwork, images: Tensor, azimuth: float | None) -> tuple[Tensor, Tensor, float, Tensor]:
    """Predict voxels [1, 32, 32, 32], the pose [1, 6], a threshold whose outline agrees best, and the categories."""
    if azimuth is None:
        occupancy, pose, category = network.search(images)
    else:
        category, (pose,), _ = network.recognize(images)
        pose[:, 0] = math.radians(azimuth - 90)
        occupancy = network.occupancy(images, pose)
    thresholds = [threshold for threshold in _THRESHOLDS if float(occupancy.max()) > threshold]
    if not thresholds:
        raise ValueError("expected a solid object, got a picture in which the network sees none")
    threshold = max(thresholds, key=lambda level: float(outline_iou((occupancy > level).float(), images, pose)))
    return occupancy, pose, threshold, category[0]


def fit_outline(
    vertices: Tensor,
    faces: Tensor,
    images: Tensor,
    pose: Tensor,
    steps: int,
    observe: Callable[[int, float], Any] | None = None,
) -> tuple[Tensor, Tensor]:
    """Deform a mesh and adjust its pose [1, 6] until its outline agrees with the picture; return vertices and pose.

    The deformation is a lattice of displacements, symmetric about the plane x = 0, so that it is smooth, keeps holes,
    and moves hidden parts like visible ones. Vertices are in the frame of the models, the picture [1, 4, 64, 64] in [0,
    1] is cropped, and 0 steps of Adam change nothing.
    """
    lattice = torch.zeros(1, 3, _LATTICE, _LATTICE, _LATTICE, requires_grad=True)
    change = torch.zeros_like(pose, requires_grad=True)
    scale = torch.tensor([0.5, 0.5, 1.0, 1.0, 1.0, 1.0])  # angles change less
    sign = torch.tensor([-1.0, 1, 1])[:, None, None, None]
    grid = (2 * vertices)[None, :, None, None]

    def deformed() -> tuple[Tensor, Tensor]:
        even = (lattice + sign * lattice.flip(4)) / 2
        moved = F.grid_sample(even, grid, padding_mode="border", align_corners=True)[0, :, :, 0, 0].T
        return vertices + moved, pose + change * scale

    optimizer = Adam([lattice, change], _RATE, _BETAS)  # torch's imports its compiler, a second
    for step in range(1, steps + 1):
        with torch.enable_grad():
            points, view = deformed()
            alpha = render((clip_points(points, view), faces), None, SIZE, outputs="alpha", gradient="edge").alpha
            bend = sum(lattice.diff(dim=axis).square().sum() for axis in (2, 3, 4))
            loss = silhouette_iou_loss(alpha, images[:, 3]) + _STIFF * bend
            lattice.grad, change.grad = torch.autograd.grad(loss, (lattice, change))
        optimizer.step()
        if observe is not None and observe(step, float(loss.detach())) is False:
            break
    points, view = deformed()
    return points.detach(), view.detach()


def picture_colors(vertices: Tensor, faces: Tensor, image: Tensor, pose: Tensor) -> Tensor:
    """Colour vertices [V, 3] by a cropped picture [1, 4, S, S] of pose [1, 6]: RGB [V, 3].

    A hidden vertex takes the colour of the visible one that is nearest, in position and normal, to it or to its mirror
    image at x = 0.
    """
    from scipy.spatial import cKDTree

    size = image.shape[-1]
    place = camera_points(vertices, pose)
    low, high = place[..., 2].min(), place[..., 2].max()
    depth = (place[0, :, 2] - low) / (high - low).clamp(min=1e-6)
    clip = clip_points(vertices, pose)
    corners = depth[faces.long()][..., None].expand(-1, -1, 3)
    buffer = render((clip, faces, corners), None, size, light=None, outputs="rgb", background=1.0).rgb[:, :1]
    grid = torch.stack((place[..., 0], -place[..., 1]), -1)[:, :, None]
    front = -F.max_pool2d(-buffer, 3, 1, 1)
    before = F.grid_sample(front, grid, align_corners=False)[0, 0, :, 0]
    solid = (image[:, 3:] > _INSIDE).float()
    solid = -F.max_pool2d(-solid, 3, 1, 1)  # pixels at the outline are mixed with the background
    rgba = F.grid_sample(torch.cat((image[:, :3], solid), 1), grid, align_corners=False)[0, :, :, 0].T
    normals = vertex_normals(vertices, faces)[0]
    close = depth - before < _BEHIND / float((high - low).clamp(min=1e-6)) + _ROUNDING
    visible = close & (rgba[:, 3] > 0.5)
    if not bool(visible.any()):
        mean = (image[0, :3] * image[0, 3:]).sum((1, 2)) / image[0, 3:].sum().clamp(min=1e-6)
        return mean.expand(len(vertices), 3).clamp(0, 1)
    flip = torch.tensor([-1.0, 1.0, 1.0])
    keys = [torch.cat((vertices * f, _NORMAL * normals * f), 1) for f in (torch.ones(3), flip)]
    tree = cKDTree(keys[0][visible].numpy())
    (distance, mine), (other, mirrored) = (tree.query(key.numpy(), k=4) for key in keys)
    chosen = np.where((distance[:, :1] <= other[:, :1] + _NEARER), mine, mirrored)
    colors = rgba[visible][:, :3][torch.from_numpy(chosen)].mean(1)
    return torch.where(visible[:, None], rgba[:, :3], colors).clamp(0, 1)
