"""`MeshEdit`: gradient descent on vertices and texture for a loss on images (section 4.2 of the paper)."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ...base import validate
from ...camera import Camera
from ...compat.first_packages.adam import Adam
from ...meshes.mesh import Mesh
from ...meshes.topology import Topology
from ...meshes.uv_mesh import UVMesh
from ...raster import Images
from ...rendering.forward import render
from ...shading.lights import Light
from ..common.adjustable import Resumable, generator
from ..common.geometry.extent import extent
from ..common.observer import Knob, weight_knobs, with_weight
from ..common.short_names import short_names
from .objective import Deformation, Objective
from .options import PAPER_STYLE, EditOptions
from .paint import FacePaint, ImagePaint, Paint
from .random_views import RandomViews

_DARKEST = 0.05  # initial colours are in [0.05, 0.95]: closer to 0 or 1, the gradient of the sigmoid vanishes
_RATES = ("vertex_rate", "texture_rate")
_BACKGROUNDS = {"the objective's": None, "black": 0.0, "grey": 0.5, "white": 1.0}
_RARELY = 0.05  # texels visible in a smaller share of the steps are filled from adjacent ones
_NOISE = 0.05  # standard deviation of the noise on plain initial colours, before the sigmoid
_HELD_OUT, _HELD_OUT_AZIMUTH = 8, 11.0  # number of the views of `MeshEdit.measure`, and azimuth of the first in degrees


@dataclass(frozen=True)
class EditSettings:
    """Settings of the gradient descent of `MeshEdit`.

    Attributes:
        steps: Number of steps, ≥ 1.
        batch: Images per step, ≥ 1.
        size: Side of the images in pixels, ≥ 32.
        vertex_rate, texture_rate: Adam's α for vertices and for colours, ≥ 0; 0 keeps the shape or the texture.
        settle: Fraction of the steps, in [0, 1], in which both rates decay linearly to 0 at the end; 0 for no decay.
        gradient: Gradient estimator of the renderer, "nmr" or "edge".
        seed: Seed of the views and of random colours.

    Raises:
        TypeError, ValueError: A value is out of range.

    Example:
        >>> from neural_renderer.apps.edit import EditSettings
        >>> EditSettings(steps=200, size=128).batch
        4
    """

    steps: int = PAPER_STYLE.steps
    batch: int = EditOptions.batch
    size: int = EditOptions.size
    vertex_rate: float = PAPER_STYLE.vertex_rate
    texture_rate: float = PAPER_STYLE.texture_rate
    settle: float = PAPER_STYLE.settle
    gradient: str = EditOptions.gradient
    seed: int = EditOptions.seed

    def __post_init__(self) -> None:
        for name, least in (("steps", 1), ("batch", 1), ("size", 32), ("seed", 0)):
            validate.whole(name, getattr(self, name), least)
        for name in _RATES:
            validate.not_negative(name, getattr(self, name))
        validate.fraction("settle", self.settle)


class MeshEdit(Resumable):
    """Optimise a mesh with Adam for an objective on images from random views. Call `advance` until ``done``.

    The mesh is edited in [-1, 1]³ and returned in its original coordinates. Vertices at equal positions move together.
    Colours are the sigmoid of the optimised parameters.

    Args:
        mesh: Mesh with initial colours. The images of a `UVMesh` are painted at their own size; the faces of a `Mesh`
            get new texels.
        objective: Loss on the images.
        views: Distribution of cameras and lights.
        descent: Settings of gradient descent. Keywords set single fields, too, such as ``steps``.
        start: Initial colours: "mesh", its own; "plain", the plain colour of the objective with a little noise, for a
            mesh without colours; "random", grey with a little noise.
        texture_size: T, texels along the edge of a face's texture cube, ≥ 1, or ≥ 3 if seamless. Ignored for a
            `UVMesh`.
        seamless: Whether adjacent faces share the texels on their edges. In the published code they do not. Ignored
            for a `UVMesh`.

    Attributes:
        phase: Name of the objective.
        step: Number of steps taken.
        steps: Number of steps.
        seconds: Time of the steps: "renderer", "network" (the objective), each with its gradient, and "rest".

    Raises:
        TypeError, ValueError: An argument does not fit, or the texture takes more than 2 GiB.

    Example:
        >>> from neural_renderer.apps.common.features import vgg
        >>> from neural_renderer.apps.edit import MeshEdit, Style
        >>> network = vgg({"conv1_1.weight": torch.rand(8, 3, 3, 3), "conv1_1.bias": torch.zeros(8)})
        >>> style = Style(network, painting=torch.rand(3, 48, 64), size=64, layers=["conv1_1"])
        >>> edit = MeshEdit(nr.Mesh.icosphere(1), style, steps=2, size=64)
        >>> torch.save(edit.state_dict(), "start.pt")
        >>> while not edit.done:
        ...     losses = edit.advance()
        >>> edit.mesh().save("painted.glb")
        >>> edit.adjust("texture_rate", 0.01)
        >>> [knob.name for knob in edit.knobs()][:3]
        ['vertex_rate', 'texture_rate', 'content']
        >>> moved, style_loss = edit.displacement()["mean"], edit.measure()
        >>> edit.load_state_dict(torch.load("start.pt"))  # back to the start
    """

    @short_names(
        *("descent.steps", "descent.batch", "descent.size", "descent.vertex_rate", "descent.texture_rate"),
        *("descent.settle", "descent.gradient", "descent.seed"),
    )
    def __init__(
        self,
        mesh: Mesh | UVMesh,
        objective: Objective,
        views: RandomViews = RandomViews(),  # noqa: B008 (immutable)
        *,
        descent: EditSettings = EditSettings(),
        start: str = PAPER_STYLE.init,
        texture_size: int = EditOptions.texture_size,
        seamless: bool = PAPER_STYLE.seamless,
    ) -> None:
        self.steps, self.step = descent.steps, 0
        self._batch, self._size = descent.batch, descent.size
        self._gradient, self._seed = descent.gradient, descent.seed
        self.phase = objective.name
        self._objective, self._views = objective, views
        texture_size = validate.whole("texture_size", texture_size, 1)
        self._rates = [descent.vertex_rate, descent.texture_rate]
        self._settle = descent.settle
        self._background = next(iter(_BACKGROUNDS))

        points, self._merged = torch.unique(mesh.vertices.detach(), dim=0, return_inverse=True)
        corners = self._merged[mesh.faces.long()]
        self._center, self._scale = extent(points[corners])  # without unused vertices
        self._start = (points - self._center) / self._scale
        self._vertices = self._start.clone().requires_grad_()
        self._topology = Topology.of(corners)

        self._paint: Paint
        if isinstance(mesh, UVMesh):
            self._paint = ImagePaint(mesh, corners)
        else:
            self._paint = FacePaint(mesh, corners, texture_size, seamless)
        colors = self._initial_colors(start, mesh.vertices.device)
        self._colors = torch.logit(colors.clamp(_DARKEST, 1 - _DARKEST)).requires_grad_()
        self._unpainted = start == "mesh" and not self._rates[1]  # the original texture is kept exactly
        self._visible_steps = torch.zeros(self._paint.count, dtype=torch.int32, device=self._colors.device)

        groups = zip((self._vertices, self._colors), self._rates, strict=True)
        self._optimizer = Adam([{"params": [parameter], "lr": rate} for parameter, rate in groups])
        self.seconds = {"renderer": 0.0, "network": 0.0, "rest": 0.0}
        self._before: float | None = None

    @property
    def before(self) -> float:
        """Result of `measure` before the first step."""
        if self._before is None:
            self._before = self.measure()
        return self._before

    @property
    def done(self) -> bool:
        """Whether all steps are taken."""
        return self.step >= self.steps

    @torch.no_grad()
    def mesh(self, fill: bool = True) -> Mesh | UVMesh:
        """Make the current mesh.

        Args:
            fill: Fill texels that were rarely visible from those around them, which takes most of the time.

        Returns:
            The mesh, in its original coordinates and of its original class.

        Raises:
            TypeError: ``fill`` is not a bool.
        """
        fill = validate.flag("fill", fill)
        vertices = self._vertices[self._merged] * self._scale + self._center
        colors = torch.sigmoid(self._colors)
        if fill and not self._unpainted:
            return self._paint.finish(vertices, colors, self._visible_steps > _RARELY * self.step)
        rough = self._paint.unpainted(vertices) if self._unpainted else self._paint.apply(vertices, colors)
        return rough if isinstance(rough, UVMesh) else Mesh(rough[0], rough[1], rough[2])

    def displacement(self) -> dict[str, float]:
        """Measure the displacement of vertices, relative to the mesh's longest side.

        Returns:
            "mean" and "most".
        """
        distance = (self._vertices.detach() - self._start).norm(dim=1) / 2
        return {"mean": distance.mean().item(), "most": distance.max().item()}

    def advance(self) -> dict[str, float]:
        """Take one step.

        Returns:
            The weighted losses before the step by name, and "loss", their sum.
        """
        _ = self.before  # must be measured before the first step
        clock = _Clock(self._vertices.device)
        random = generator(self._seed, self.step)
        camera, light = self._views.sample(self._batch, random)
        background = self._objective.background(self._batch, random)
        if _BACKGROUNDS[self._background] is not None:
            background = torch.full_like(background, _BACKGROUNDS[self._background])  # type: ignore[arg-type]
        mesh = self._mesh_to_draw()
        started = clock()
        images = self._draw(mesh, camera, light, background)
        drawn = clock()
        rgb, alpha = images.rgb, images.alpha
        pixels = rgb.detach().requires_grad_()
        deformation = Deformation(self._vertices, self._start, self._topology)
        parts = self._objective.losses(pixels, alpha.detach(), deformation)
        loss = torch.stack(list(parts.values())).sum()
        self._optimizer.zero_grad()
        loss.backward()
        judged = clock()
        rgb.backward(pixels.grad)
        returned = clock()
        self._descend()
        if self._colors.grad is not None:
            self._visible_steps += (self._colors.grad != 0).any(1)
        self.step += 1
        self.seconds["renderer"] += drawn - started + returned - judged
        self.seconds["network"] += judged - drawn
        self.seconds["rest"] += started - clock.start + clock() - returned
        return {"loss": loss.item(), **{name: part.item() for name, part in parts.items()}}

    def knobs(self) -> list[Knob]:
        """List the settings that may change between two steps.

        Returns:
            "vertex_rate", "texture_rate", the weights of the objective, and "background".
        """
        rates = [Knob(name, rate) for name, rate in zip(_RATES, self._rates, strict=True)]
        weights = weight_knobs(getattr(self._objective, "weights", None))
        return [*rates, *weights, Knob("background", self._background, choices=tuple(_BACKGROUNDS))]

    def adjust(self, name: str, value: float | str) -> None:
        if name == "background":
            if value not in _BACKGROUNDS:
                raise ValueError(f"background: expected one of {', '.join(_BACKGROUNDS)}, got {value!r}")
            self._background = str(value)
        elif name in _RATES:
            self._rates[_RATES.index(name)] = validate.not_negative(name, value)
        else:
            weights = with_weight(getattr(self._objective, "weights", None), name, value)
            self._objective.weights = weights  # type: ignore[attr-defined]

    def measure(self) -> float:
        """Compute the objective's main measure on eight fixed views that are not used by steps.

        Returns:
            The mean over these views.
        """
        camera, light = self._views.fixed(_HELD_OUT, offset=_HELD_OUT_AZIMUTH)
        background = self._objective.background(_HELD_OUT, generator(-1, 0))
        with torch.no_grad():
            images = self._draw(self._mesh_to_draw(), camera, light, background)
            found = [
                self._objective.measure(rgb, alpha)
                for rgb, alpha in zip(images.rgb.split(self._batch), images.alpha.split(self._batch), strict=True)
            ]
        return torch.cat(found).mean().item()

    def state_dict(self) -> dict[str, Any]:
        return {
            "step": self.step,
            "vertices": self._vertices.detach(),
            "colors": self._colors.detach(),
            "visible_steps": self._visible_steps,
            "optimizer": self._optimizer.state_dict(),
            "seconds": dict(self.seconds),
            "before": self.before,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Resume from the state of an edit of the same mesh.

        Args:
            state: Result of `state_dict`.

        Raises:
            KeyError: A name is missing.
            ValueError: More steps are taken already than this edit has.
        """
        if state["step"] > self.steps:
            raise ValueError(f"steps: expected at least the {state['step']} steps already taken, got {self.steps}")
        with torch.no_grad():
            self._vertices.copy_(state["vertices"])
            self._colors.copy_(state["colors"])
            self._visible_steps.copy_(state["visible_steps"])
        self._optimizer.load_state_dict(state["optimizer"])
        self.step, self._before = state["step"], state["before"]
        self.seconds = dict(state["seconds"])

    def _descend(self) -> None:
        """Take a step of the optimiser with the learning rates of this step."""
        left = (self.steps - self.step) / self.steps
        for group, rate in zip(self._optimizer.param_groups, self._rates, strict=True):
            group["lr"] = rate * min(1.0, left / max(self._settle, 1e-9))  # 1e-9: no division by 0
        self._optimizer.step()

    def _mesh_to_draw(self) -> UVMesh | tuple[Tensor, ...]:
        vertices = self._vertices[self._merged]
        if self._unpainted:
            return self._paint.unpainted(vertices)
        return self._paint.apply(vertices, torch.sigmoid(self._colors))

    def _draw(self, mesh: Any, camera: Camera, light: Light | None, background: Tensor) -> Images:
        return render(
            mesh,
            camera,
            self._size,
            light=light,
            background=background.to(self._vertices.device),
            outputs=("rgb", "alpha"),
            gradient=self._gradient,
        )

    def _initial_colors(self, start: str, device: torch.device) -> Tensor:
        if start in ("plain", "random"):
            noise = torch.randn(self._paint.count, 3, generator=torch.Generator().manual_seed(self._seed)).to(device)
            plain = self._objective.plain.to(device).clamp(_DARKEST, 1 - _DARKEST)
            return torch.sigmoid((torch.logit(plain) if start == "plain" else 0) + _NOISE * noise)
        if start != "mesh":
            raise ValueError(f'start: expected "mesh", "plain" or "random", got {start!r}')
        return self._paint.initial()


class _Clock:
    """A clock in seconds that waits for the device to finish its work."""

    def __init__(self, device: torch.device) -> None:
        self._device = device
        self.start = self()

    def __call__(self) -> float:
        if self._device.type == "cuda":
            torch.cuda.synchronize(self._device)
        return time.perf_counter()
