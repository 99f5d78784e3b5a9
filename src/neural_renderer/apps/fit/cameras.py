"""Refinement of cameras: poses and focal length, while the shape is fitted or after it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch import Tensor

from ...camera import Camera
from ...camera.camera import with_extrinsics, world_origin
from ...optim.losses import photometric, silhouette_iou_loss
from ..common.views.views import Views, photos_of
from .descent import VectorAdam
from .detail.pyramid import coarse
from .weights import FitWeights

_FOCAL_RATE = 0.3  # step of the focal length, relative to that of poses, because all views change it
_PRIOR = 2.5  # weight of squared corrections, in radians or relative to the depth
_FREEDOMS = 6  # parameters of a pose: three of rotation, three of place
_LEAST_SPREAD = 1e-6  # squared spread of the cameras below which the scale stays
COARSE_RATE = 0.01
"""First step of a camera whose shape is coarse, or known."""


class CameraRefinement:
    """Poses and the focal length of N cameras as parameters of a descent, with a prior at their initial values.

    Images do not change under a similarity transform of mesh and cameras together. `settle` removes this freedom: on
    average, the cameras keep their initial poses. One factor scales the focal lengths of all cameras. Parallel cameras
    keep their scale, which is equivalent to the size of the object.

    Args:
        camera: N cameras, in a world where the object lies in about [-1, 1]³.
        focal: Whether the focal length may change.

    Attributes:
        begun: The cameras at the beginning.
        parameters: Changes of the poses [N, 6] and of the focal length [1, 1], see `change_cameras`. `step` replaces
            them.
    """

    parameters: tuple[Tensor, Tensor]

    def __init__(self, camera: Camera, focal: bool = True) -> None:
        self.begun, self._has_focal = camera, focal and camera.perspective
        self._restart(camera)

    @property
    def camera(self) -> Camera:
        """The current cameras, without gradients."""
        with torch.no_grad():
            return change_cameras(self._base, *self.parameters)

    def share_lens(self, views: Views) -> Views:
        """Apply the current correction of the focal length to other views with the same lens."""
        now, begun = self.camera, self.begun
        if not self._has_focal:
            return views
        first, last = (torch.deg2rad(torch.as_tensor(camera.fov) / 2).tan() for camera in (begun, now))
        focal = (first / last).log().reshape(-1)[:1]
        still = views.camera.rotation.new_zeros(len(views), _FREEDOMS)
        return replace(views, camera=change_cameras(views.camera, still, focal))

    def place(self, views: Views, rows: Sequence[int]) -> Views:
        """Give views of the cameras in these rows the current ones, through which gradients flow to `parameters`."""
        poses, focal = self.parameters
        some = list(rows)
        return replace(views, camera=change_cameras(self._base[some], poses[some], focal))

    def prior(self) -> Tensor:
        """Compute the prior [], a loss that keeps the cameras near their initial poses."""
        poses, focal = self.parameters
        return _PRIOR * (poses.square().sum(1).mean() + focal.square().sum())

    def step(self, gradients: Sequence[Tensor], rows: Sequence[int], rate: float) -> None:
        """Take one step of descent of the cameras in these rows, by gradients of the loss by `parameters`.

        ``rate`` is the length of the step, in radians and relative to the depth.
        """
        poses, focal = (part.detach().clone() for part in self.parameters)
        for row in rows:
            place = slice(row, row + 1)
            poses[place] = self._descents[row].step(poses[place], gradients[0][place], rate)
        if self._has_focal:
            focal = self._descents[-1].step(focal, gradients[1], _FOCAL_RATE * rate)
        self.parameters = poses.requires_grad_(), focal.requires_grad_()

    def settle(self, vertices: Tensor) -> Tensor:
        """Transform cameras and mesh by the similarity that brings the cameras nearest to their initial poses.

        Returns the moved vertices [V, 3]; images stay the same.
        """
        back = Similarity.between(self.camera, self.begun)
        self._restart(back.cameras(self.camera))
        return back.points(vertices)

    def _restart(self, camera: Camera) -> None:
        """Begin to change these cameras."""
        self._base = camera
        poses = camera.rotation.new_zeros(len(camera), _FREEDOMS)
        self.parameters = poses.requires_grad_(), camera.rotation.new_zeros(1, 1).requires_grad_()
        self._descents = [VectorAdam() for _ in range(len(camera) + 1)]  # the last one for the focal length

    def state_dict(self) -> dict[str, Any]:
        """Return everything that changes from step to step."""
        base = {part.name: getattr(self._base, part.name) for part in fields(self._base)}
        descents = [descent.state_dict() for descent in self._descents]
        return {"base": base, "parameters": [part.detach() for part in self.parameters], "descents": descents}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Resume from a `state_dict`."""
        self._restart(Camera(**state["base"]))
        poses, focal = state["parameters"]
        self.parameters = poses.requires_grad_(), focal.requires_grad_()
        for descent, means in zip(self._descents, state["descents"], strict=True):
            descent.load_state_dict(means)


def change_cameras(camera: Camera, poses: Tensor, focal: Tensor) -> Camera:
    """Change poses and focal length of N cameras; differentiable in the changes.

    A rotation turns the scene around the origin of the world, where the object is, and not around the camera: a turned
    camera and one that moved sideways look almost the same, and descent would confuse them. Poses [N, 6] are a rotation
    vector around the camera's axes, in radians, and the shift of the world's origin along these axes, relative to its
    depth; ``focal`` is the logarithm of the factor of all focal lengths, or of the scale of parallel cameras.
    """
    poses, focal = poses.to(camera.rotation), focal.to(camera.rotation)
    place = world_origin(camera)
    rotation = torch.linalg.matrix_exp(_cross_matrix(poses[:, :3])) @ camera.rotation
    place = place + place[:, 2:] * poses[:, 3:]
    return with_extrinsics(camera.zoomed(focal.reshape(()).exp()), rotation, place)


def _cross_matrix(vectors: Tensor) -> Tensor:
    """Make the matrices [N, 3, 3] that compute cross products with vectors [N, 3]."""
    x, y, z = vectors.unbind(1)
    zero = torch.zeros_like(x)
    rows = (zero, -z, y, z, zero, -x, -y, x, zero)
    return torch.stack(rows, 1).view(-1, 3, 3)


@dataclass(frozen=True, eq=False)
class Similarity:
    """Map of points X to scale · rotation · X + shift, with scale > 0, rotation [3, 3] and shift [3]."""

    scale: float
    rotation: Tensor
    shift: Tensor

    @classmethod
    def between(cls, camera: Camera, other: Camera) -> Similarity:
        """Find the similarity that best aligns N cameras with N others, see `of_poses`."""
        poses = (camera.rotation, camera.position), (other.rotation, other.position)
        found = cls.of_poses(*((turn.detach(), eye.detach()) for turn, eye in poses))
        return cls(found.scale, found.rotation.to(camera.rotation), found.shift.to(camera.rotation))

    @classmethod
    def of_poses(cls, poses: tuple[Tensor, Tensor], others: tuple[Tensor, Tensor]) -> Similarity:
        """Find the similarity that best aligns N rotations from the world [N, 3, 3], and places [N, 3], with N others.

        The rotation is the mean rotation between the cameras (Moakher, "Means and averaging in the group of rotations",
        2002, section 3.1). Scale and shift bring the positions together by least squares (Umeyama, 1991). The result
        is float64.
        """
        mean = torch.einsum("bij,bik->jk", others[0], poses[0])
        left, _, right = torch.linalg.svd(mean.double())
        rotation = left @ torch.diag(left.new_tensor([1.0, 1.0, float(torch.linalg.det(left @ right))])) @ right
        eyes, goals = poses[1].double(), others[1].double()
        around, goals_around = (eyes - eyes.mean(0)) @ rotation.t(), goals - goals.mean(0)
        spread = float(around.square().sum())
        scale = float((around * goals_around).sum()) / spread if spread > _LEAST_SPREAD * len(eyes) else 1.0
        shift = goals.mean(0) - scale * (rotation @ eyes.mean(0))
        return cls(scale, rotation, shift)

    def points(self, points: Tensor) -> Tensor:
        """Map points [V, 3]."""
        return self.scale * points @ self.rotation.t() + self.shift

    def cameras(self, camera: Camera) -> Camera:
        """Move cameras so that mapped points give the same images."""
        rotation = camera.rotation @ self.rotation.t()
        place = self.scale * world_origin(camera) - rotation @ self.shift
        return with_extrinsics(camera if camera.perspective else camera.zoomed(1 / self.scale), rotation, place)


def locate_cameras(views: Views, shape: tuple[Tensor, ...], steps: int = 40) -> Views:
    """Refine the poses of `Views.normalized` views of a known mesh, (vertices, faces) or with textures, which stays.

    A fit with refined cameras says little about views whose cameras are as wrong as the others were. So they are
    located before the fit is measured on them, as in Lin et al., "BARF" (2021), section 4.
    """
    colored = views.photos is not None and len(shape) == 3
    small = coarse(views)
    found = []
    for row in range(len(views)):
        view = small[[row]]
        refinement = CameraRefinement(view.camera, focal=False)
        best, camera = float("inf"), view.camera
        for step in range(steps):
            images = refinement.place(view, [0]).draw(shape, ("rgb", "alpha") if colored else "alpha")
            loss = silhouette_iou_loss(images.alpha, view.masks)
            if colored:
                loss = loss + FitWeights.photometric * photometric(images.rgb, photos_of(view), view.masks)
            if loss.item() < best:
                best, camera = loss.item(), refinement.camera
            gradients = torch.autograd.grad(loss, refinement.parameters)
            refinement.step(gradients, [0], COARSE_RATE * (1 - step / steps))
        found.append(camera)
    return replace(views, camera=type(views.camera).cat(found))
