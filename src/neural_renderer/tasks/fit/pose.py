"""`CameraFit`: the camera of one image of a known mesh, by gradient descent from many initial cameras."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from ... import losses, validate
from ...camera import Camera
from ...meshes.bounds import bounding_box
from ...rendering import render
from ..adjustable import Adjustable
from .descent import VectorAdam
from .fit_views import downscale, mask_iou

_COARSE, _FINE = 64, 128  # longer side of the images in pixels, in the first two thirds of the steps and in the last
_CAMERAS_AT_ONCE = 8  # cameras rendered together without gradients, which limits memory
_DECAY = 0.95  # β₂ of the descent
_HALF_HEIGHT = 1.2  # half the height of the initial images, in radii of the object
_LAST_RATE = 0.03  # step size at the end, relative to the first
_NEAR, _FAR = 1e-2, 1e3  # clipping planes, in radii of the object


class CameraFit(Adjustable):
    """Fit the camera of an image by gradient descent from several initial cameras. Call `advance` until ``done``.

    Initial cameras stand upright in random directions. Their distance and aim make their silhouettes as large as that
    of the image, and put them at the same place. Each camera descends on its own loss.

    Args:
        shape: (vertices [V, 3], faces [F, 3]), or with textures [F, T, T, T, 3] to compare colours too.
        mask: [H, W] in [0, 1], silhouette of the object.
        photo: [3, H, W] RGB multiplied by the mask, or None.
        viewing_angle: Known half of the vertical field of view in degrees, in (0, 90).
        starts: Number of initial cameras, ≥ 1.
        steps: Number of steps, ≥ 1.
        photometric: Weight of the mean squared difference of colours; the weight of silhouettes is 1.
        rate: Step size, in radians and relative to the distance.
        gradient: Gradient estimator of the renderer, "edge" or "nmr".
        seed: Seed of the initial cameras.

    Raises:
        TypeError, ValueError: An argument does not fit, or the mask is empty.

    Example:
        >>> from neural_renderer.tasks.fit import CameraFit
        >>> mask = nr.render(mesh, camera, 32).alpha[0].detach()
        >>> fit = CameraFit((mesh.vertices, mesh.faces), mask, starts=2, steps=2)
        >>> torch.save(fit.state_dict(), "start.pt")
        >>> while not fit.done:
        ...     loss = fit.advance()["loss"]
        ...     fit.turn("rate", 0.05)
        >>> len(fit.best()), len(fit.cameras())
        (1, 2)
        >>> [knob.name for knob in fit.knobs()]
        ['rate']
        >>> fit.losses().shape, fit.iou().shape
        (torch.Size([2]), torch.Size([2]))
        >>> fit.load_state_dict(torch.load("start.pt"))  # back to the start
    """

    phase = "camera"

    _axes: Tensor  # [S, 6]: viewing direction and up vector, not orthonormal
    _offset: Tensor  # [S, 3]: the object's centre in camera space as (x/z, y/z, log z)
    _descents: tuple[VectorAdam, VectorAdam]  # optimisers of `_axes` and `_offset`, with step sizes per camera

    def __init__(
        self,
        shape: tuple[Tensor, ...],
        mask: Tensor,
        photo: Tensor | None = None,
        *,
        viewing_angle: float = 30.0,
        starts: int = 16,
        steps: int = 150,
        photometric: float = 5.0,
        rate: float = 0.06,
        gradient: str = "edge",
        seed: int = 0,
    ) -> None:
        validate.floating("mask", mask, ("H", "W"))
        if photo is not None:
            validate.floating("photo", photo, (3, *mask.shape))
        if float(mask.max()) <= 0.5:
            raise ValueError("mask: expected an object, got an empty mask")
        self.steps, self.step = validate.whole("steps", steps, 1), 0
        self._angle, self._gradient = validate.positive("viewing_angle", viewing_angle), gradient
        self._photometric = photometric if photo is not None and len(shape) == 3 else 0.0
        self._rate = validate.positive("rate", rate)
        vertices = shape[0].detach()
        self._center, _ = bounding_box(vertices)
        self._scale = float((vertices - self._center).norm(dim=1).max())
        self._shape = ((vertices - self._center) / self._scale, *(part.detach() for part in shape[1:]))
        self._mask = downscale(mask[None], _FINE)
        self._photo = self._mask.expand(3, -1, -1) if photo is None else downscale(photo, _FINE)
        self._place_cameras(validate.whole("starts", starts, 1), seed)

    def cameras(self) -> Camera:
        """Make the current cameras.

        Returns:
            S cameras, one for each start, in the world of the mesh.
        """
        camera = self._camera(self._axes.detach(), self._offset.detach())
        origin = camera.origin * self._scale + self._center
        return Camera(camera.rotation, origin, torch.zeros_like(origin), viewing_angle=self._angle)

    def best(self) -> Camera:
        """Make the camera with the least loss.

        Returns:
            One camera, in the world of the mesh.
        """
        camera, row = self.cameras(), [int(self.losses().argmin())]
        return Camera(camera.rotation[row], camera.origin[row], camera.translation[row], viewing_angle=self._angle)

    def losses(self) -> Tensor:
        """Compute the loss of each start at the fine size.

        Returns:
            [S], without a gradient.
        """
        with torch.no_grad():
            return torch.cat([self._losses(self._axes[part], self._offset[part], _FINE) for part in self._parts()])

    def iou(self) -> Tensor:
        """Compute the silhouette IoU of each start at the fine size.

        Returns:
            [S] in [0, 1], without a gradient.
        """
        alpha = self._silhouettes()
        return mask_iou(alpha, self._mask.expand_as(alpha))

    def advance(self) -> dict[str, float]:
        """Take one step of all starts.

        Returns:
            "loss", that of the best start before the step.
        """
        axes, offset = self._axes.requires_grad_(), self._offset.requires_grad_()
        each = self._losses(axes, offset, _COARSE if self.step < 2 * self.steps // 3 else _FINE)
        gradients = torch.autograd.grad(each.sum(), (axes, offset))
        rate = self._rate * (1 + _LAST_RATE - self.step / self.steps)
        self.step += 1
        self._axes = self._descents[0].step(axes.detach(), gradients[0], rate)
        self._offset = self._descents[1].step(offset.detach(), gradients[1], rate)
        return {"loss": each.min().item()}

    def state_dict(self) -> dict[str, Any]:
        descents = [descent.state_dict() for descent in self._descents]
        return {"step": self.step, "axes": self._axes, "offset": self._offset, "descents": descents}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.step, self._axes, self._offset = state["step"], state["axes"], state["offset"]
        for descent, means in zip(self._descents, state["descents"], strict=True):
            descent.load_state_dict(means)

    def _place_cameras(self, starts: int, seed: int) -> None:
        """Place upright cameras in random directions, and match size and place of the silhouette."""
        generator = torch.Generator().manual_seed(seed)
        device = self._mask.device
        height = 2 * torch.rand(starts, generator=generator) - 1  # uniform on the sphere
        azimuth = 2 * math.pi * torch.rand(starts, generator=generator)
        level = (1 - height**2).sqrt()
        forward = -torch.stack((level * azimuth.sin(), height, level * azimuth.cos()), 1)
        right = F.normalize(torch.linalg.cross(forward, torch.tensor([[0.0, 1.0, 0.0]]).expand_as(forward)), dim=1)
        self._axes = torch.cat((forward, torch.linalg.cross(right, forward)), 1).to(device)
        tangent = math.tan(math.radians(self._angle))
        self._offset = torch.tensor([0.0, 0.0, math.log(_HALF_HEIGHT / tangent + 1)], device=device).repeat(starts, 1)
        self._descents = VectorAdam(_DECAY, each_row=True), VectorAdam(_DECAY, each_row=True)
        area, center = _area_and_center(self._mask)
        for _ in range(2):
            areas, centers = _area_and_center(self._silhouettes())
            self._offset[:, 2] += 0.5 * (areas / area).log()
            self._offset[:, :2] += (center - centers) * tangent

    def _parts(self) -> Iterator[slice]:
        """Divide the starts into parts that are rendered together."""
        return (slice(i, i + _CAMERAS_AT_ONCE) for i in range(0, len(self._axes), _CAMERAS_AT_ONCE))

    def _camera(self, axes: Tensor, offset: Tensor) -> Camera:
        """Make cameras of the normalised mesh from ``_axes`` and ``_offset``."""
        forward = F.normalize(axes[:, :3], dim=1)
        right = F.normalize(torch.linalg.cross(forward, axes[:, 3:]), dim=1)
        rotation = torch.stack((right, torch.linalg.cross(right, forward), forward), 1)
        depth = offset[:, 2:].exp()
        center = torch.cat((offset[:, :2] * depth, depth), 1)
        origin = -torch.einsum("bij,bi->bj", rotation, center)
        return Camera(rotation, origin, torch.zeros_like(origin), viewing_angle=self._angle)

    @torch.no_grad()
    def _silhouettes(self) -> Tensor:
        """Render the silhouettes of all starts, [S, H, W], at the fine size."""
        return torch.cat([self._draw(self._axes[part], self._offset[part], _FINE)[1] for part in self._parts()])

    def _draw(self, axes: Tensor, offset: Tensor, longest: int) -> tuple[Tensor | None, Tensor]:
        """Render colours [S, 3, H, W], if they are compared, and silhouettes [S, H, W]."""
        height, width = downscale(self._mask, longest).shape[1:]
        images = render(
            self._shape,
            self._camera(axes, offset),
            (height, width),
            light=None,
            outputs=("rgb", "alpha") if self._photometric else ("alpha",),
            near=_NEAR,
            far=_FAR,
            gradient=self._gradient,
        )
        return images.rgb if self._photometric else None, images.alpha

    def _losses(self, axes: Tensor, offset: Tensor, longest: int) -> Tensor:
        """Compute the loss of each start, [S], on images of this longer side."""
        rgb, alpha = self._draw(axes, offset, longest)
        mask, photo = downscale(self._mask, longest), downscale(self._photo, longest)[None]
        each = torch.stack([losses.silhouette_iou_loss(one[None], mask) for one in alpha])
        if rgb is not None:
            error = torch.stack([losses.photometric(one[None], photo) for one in rgb])
            each = each + self._photometric * error / mask.mean()
        return each


def _area_and_center(alpha: Tensor) -> tuple[Tensor, Tensor]:
    """Compute area [B] in pixels and centroid [B, 2] of silhouettes [B, H, W].

    Coordinates are x to the right and y up from the image centre, in units of half the image's height.
    """
    height, width = alpha.shape[1:]
    area = alpha.sum((1, 2)).clamp(min=1.0)
    x = (torch.arange(width, device=alpha.device) * 2 + 1 - width) / height
    y = (height - torch.arange(height, device=alpha.device) * 2 - 1) / height
    return area, torch.stack(((alpha.sum(1) * x).sum(1) / area, (alpha.sum(2) * y).sum(1) / area), 1)
