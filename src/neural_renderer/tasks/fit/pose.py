"""The camera of one image of a known mesh: descent from many starts at once."""

from __future__ import annotations

import math
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from ... import losses, validate
from ...camera import Camera
from ...render import render
from .fit_views import agreement, smaller

_COARSE, _FINE = 64, 128  # pixels of the longer side


class CameraFit:
    """Descent on the position and direction of a camera, from several starts side by side: `advance` until ``done``.

    The starts stand at random around the mesh, upright, at the distance and with the aim that give their silhouettes
    the size and the place of the image's. Each follows the gradient of its own loss, for two thirds of the steps on
    images of 64 pixels' longer side, then of 128.

    Args:
        shape: (vertices [V, 3], faces [F, 3]) or, to compare colours too, with textures [F, T, T, T, 3].
        mask: [H, W] in [0, 1], the object's silhouette.
        photo: [3, H, W] on black, or None.
        viewing_angle: half the vertical field of view in degrees, in (0, 90), which is known.
        starts: how many, at least 1.
        steps: of descent, at least 1.
        photometric: weight of the mean squared difference of colours against that of the silhouettes.
        rate: length of a step, in radians and in parts of the distance.
        gradient: the renderer's estimator through visibility.
        seed: of the starts.

    Raises:
        TypeError, ValueError: what does not fit, and an empty mask.
    """

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
        self._centre = (vertices.amin(0) + vertices.amax(0)) / 2
        self._scale = float((vertices - self._centre).norm(dim=1).max())
        self._shape = ((vertices - self._centre) / self._scale, *(part.detach() for part in shape[1:]))
        self._mask = smaller(mask[None], _FINE)
        self._photo = self._mask.expand(3, -1, -1) if photo is None else smaller(photo, _FINE)
        self._place(validate.whole("starts", starts, 1), seed)

    phase = "camera"

    _turn: Tensor
    _shift: Tensor
    _moments: list[list[Tensor]]

    @property
    def done(self) -> bool:
        """Whether all steps are taken."""
        return self.step >= self.steps

    def cameras(self) -> Camera:
        """The camera that each start has become, in the mesh's world."""
        camera = self._camera(self._turn.detach(), self._shift.detach())
        world = camera.origin * self._scale + self._centre
        return Camera(camera.rotation, world, torch.zeros_like(world), viewing_angle=self._angle)

    def best(self) -> Camera:
        """The one whose image agrees best."""
        camera, row = self.cameras(), [int(self.losses().argmin())]
        return Camera(camera.rotation[row], camera.origin[row], camera.translation[row], viewing_angle=self._angle)

    def losses(self) -> Tensor:
        """The loss of each start [S] at full size."""
        with torch.no_grad():
            return torch.cat(
                [self._losses(self._turn[i : i + 8], self._shift[i : i + 8], _FINE) for i in self._eighths()]
            )

    def iou(self) -> Tensor:
        """The silhouette's intersection over union of each start [S]."""
        with torch.no_grad():
            found = []
            for i in self._eighths():
                alpha = self._draw(self._turn[i : i + 8], self._shift[i : i + 8], _FINE)[1]
                found.append(agreement(alpha, self._mask.expand_as(alpha)))
            return torch.cat(found)

    def advance(self) -> dict[str, float]:
        """Take one step of all starts; returns the ``loss`` of the best, before it."""
        turn, shift = self._turn.requires_grad_(), self._shift.requires_grad_()
        each = self._losses(turn, shift, _COARSE if self.step < 2 * self.steps // 3 else _FINE)
        gradients = torch.autograd.grad(each.sum(), (turn, shift))
        slow = 1.03 - self.step / self.steps
        self.step += 1
        self._turn, self._shift = (
            self._moved(index, values.detach(), gradient, self._rate * slow)
            for index, (values, gradient) in enumerate(zip((turn, shift), gradients, strict=True))
        )
        return {"loss": each.min().item()}

    def state_dict(self) -> dict[str, Any]:
        """All that changes from step to step."""
        return {"step": self.step, "turn": self._turn, "shift": self._shift, "moments": self._moments}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self.step, self._turn, self._shift = state["step"], state["turn"], state["shift"]
        self._moments = state["moments"]

    def _moved(self, index: int, values: Tensor, gradient: Tensor, rate: float) -> Tensor:
        """One step of Adam, with one size for the three or six numbers of a start."""
        mean, square = self._moments[index]
        mean = 0.9 * mean + 0.1 * gradient
        square = 0.95 * square + 0.05 * gradient.square().sum(1, keepdim=True)
        self._moments[index] = [mean, square]
        size = (square / (1 - 0.95**self.step)).sqrt().clamp(min=1e-12)
        return values - rate * mean / (1 - 0.9**self.step) / size

    def _place(self, starts: int, seed: int) -> None:
        generator = torch.Generator().manual_seed(seed)
        device = self._mask.device
        height = 2 * torch.rand(starts, generator=generator) - 1  # evenly over the sphere
        around = 2 * math.pi * torch.rand(starts, generator=generator)
        level = (1 - height**2).sqrt()
        forward = -torch.stack((level * around.sin(), height, level * around.cos()), 1)
        right = F.normalize(torch.linalg.cross(forward, torch.tensor([[0.0, 1.0, 0.0]]).expand_as(forward)), dim=1)
        self._turn = torch.cat((forward, torch.linalg.cross(right, forward)), 1).to(device)
        tangent = math.tan(math.radians(self._angle))
        self._shift = torch.tensor([0.0, 0.0, math.log(1.2 / tangent + 1)], device=device).repeat(starts, 1)
        self._moments = [[torch.zeros_like(v), torch.zeros_like(v[:, :1])] for v in (self._turn, self._shift)]
        size, middle = _place_of(self._mask)
        for _ in range(2):
            with torch.no_grad():
                alpha = torch.cat(
                    [self._draw(self._turn[i : i + 8], self._shift[i : i + 8], _FINE)[1] for i in self._eighths()]
                )
            sizes, middles = _place_of(alpha)
            self._shift[:, 2] += 0.5 * (sizes / size).log()
            self._shift[:, :2] += (middle - middles) * tangent

    def _eighths(self) -> range:
        return range(0, len(self._turn), 8)

    def _camera(self, turn: Tensor, shift: Tensor) -> Camera:
        """From two rows of a rotation [S, 6], made orthonormal, and where the mesh's centre is: (x/z, y/z, log z)."""
        forward = F.normalize(turn[:, :3], dim=1)
        right = F.normalize(torch.linalg.cross(forward, turn[:, 3:]), dim=1)
        rotation = torch.stack((right, torch.linalg.cross(right, forward), forward), 1)
        depth = shift[:, 2:].exp()
        place = torch.cat((shift[:, :2] * depth, depth), 1)
        origin = -torch.einsum("bij,bi->bj", rotation, place)
        return Camera(rotation, origin, torch.zeros_like(origin), viewing_angle=self._angle)

    def _draw(self, turn: Tensor, shift: Tensor, longest: int) -> tuple[Tensor | None, Tensor]:
        size = smaller(self._mask, longest).shape[1:]
        images = render(
            self._shape,
            self._camera(turn, shift),
            (size[0], size[1]),
            light=None,
            outputs=("rgb", "alpha") if self._photometric else ("alpha",),
            near=1e-2,
            far=1e3,
            gradient=self._gradient,
        )
        return images.rgb, images.alpha  # type: ignore[return-value]

    def _losses(self, turn: Tensor, shift: Tensor, longest: int) -> Tensor:
        """One number for each start [S]."""
        rgb, alpha = self._draw(turn, shift, longest)
        mask, photo = smaller(self._mask, longest), smaller(self._photo, longest)[None]
        each = torch.stack([losses.silhouette_iou_loss(one[None], mask) for one in alpha])
        if rgb is not None:
            error = torch.stack([losses.photometric(one[None], photo) for one in rgb])
            each = each + self._photometric * error / mask.mean()
        return each


def _place_of(alpha: Tensor) -> tuple[Tensor, Tensor]:
    """Area [B] in pixels and middle [B, 2] of silhouettes [B, H, W]: x right and y up in half heights of the image."""
    height, width = alpha.shape[1:]
    area = alpha.sum((1, 2)).clamp(min=1.0)
    x = (torch.arange(width, device=alpha.device) * 2 + 1 - width) / height
    y = (height - torch.arange(height, device=alpha.device) * 2 - 1) / height
    return area, torch.stack(((alpha.sum(1) * x).sum(1) / area, (alpha.sum(2) * y).sum(1) / area), 1)
