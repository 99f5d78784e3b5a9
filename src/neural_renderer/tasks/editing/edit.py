"""Descent on the vertices and the texture of a mesh for what a loss on its images wants (section 4.2 of the paper)."""

from __future__ import annotations

import time
from typing import Any, Protocol

import torch
from torch import Tensor

from ... import validate
from ...camera import Camera
from ...compat.adam import Adam
from ...meshes.mesh import Mesh
from ...meshes.topology import Topology
from ...meshes.uv_mesh import UVMesh
from ...raster import Images
from ...render import render
from ...shading.lights import Light
from ..seeds import generator
from .deformation import Deformation
from .paint import FacePaint, ImagePaint, Paint
from .random_views import Views

_DARKEST, _SELDOM, _HELD_OUT = 0.05, 0.05, 8  # nearer to black or white the sigmoid hardly moves


class Objective(Protocol):
    """What images of an edited mesh should be like: `Style` or `Dream`."""

    name: str
    plain: Tensor
    """[3], the colour of a mesh that has none of its own."""

    def background(self, count: int, generator: torch.Generator, /) -> Tensor: ...

    def losses(self, images: Tensor, masks: Tensor, shape: Deformation, /) -> dict[str, Tensor]: ...

    def measure(self, images: Tensor, masks: Tensor, /) -> Tensor: ...


class MeshEdit:
    """Steps of Adam on a mesh, for an objective on images from random views: call `advance` until ``done``.

    >>> network = load_features("vgg16-original")  # doctest: +SKIP
    >>> edit = MeshEdit(Mesh.load("bunny.obj"), Style(network, painting), steps=500, start="plain")  # doctest: +SKIP
    >>> while not edit.done:  # doctest: +SKIP
    ...     edit.advance()
    >>> edit.mesh().save("painted.glb")  # doctest: +SKIP

    The mesh is edited in the cube [-1, 1]³ and given back where it was. Vertices at the same place are one. Colours are
    the sigmoid of what is optimised, and begin between 0.05 and 0.95.

    Args:
        mesh: the mesh, with colours to begin with. Of a `UVMesh` the images are painted, each in its own size; of a
            `Mesh` the faces.
        objective: on its images.
        views: where it is looked at from, and in which light.
        steps: how many there are, at least 1.
        batch: images in each step, at least 1.
        size: their side in pixels, at least 32; they are drawn at twice that.
        vertex_rate, texture_rate: Adam's α, ≥ 0; 0 leaves the shape or the colours as they are.
        settle: the part of the steps, in [0, 1], at the end of which both rates have fallen to 0; 0 keeps them.
        start: "mesh", its own colours; "plain", the objective's colour with a little noise, for meshes without colours;
            or "random", grey with a little noise.
        texture_size: T, texels along the edge of a face's cube, at least 1, or 3 if seamless; not for a `UVMesh`.
        seamless: faces share the texels on their edges; False: each face has its own, as published; not for a `UVMesh`.
        gradient: the renderer's, through visibility.
        seed: of the views and of random colours.

    Raises TypeError or ValueError for what does not fit, and for textures of more than 2 GiB.
    """

    def __init__(
        self,
        mesh: Mesh | UVMesh,
        objective: Objective,
        views: Views = Views(),  # noqa: B008 (immutable)
        *,
        steps: int = 5000,
        batch: int = 4,
        size: int = 224,
        vertex_rate: float = 2.5e-4,
        texture_rate: float = 5e-2,
        settle: float = 0.3,
        start: str = "mesh",
        texture_size: int = 4,
        seamless: bool = True,
        gradient: str = "nmr",
        seed: int = 0,
    ) -> None:
        self.steps, self.step = validate.whole("steps", steps, 1), 0
        self._batch, self._size = validate.whole("batch", batch, 1), validate.whole("size", size, 32)
        self.phase = objective.name
        self._objective, self._gradient, self._seed = objective, gradient, validate.whole("seed", seed, 0)
        self._views = views
        texture_size = validate.whole("texture_size", texture_size, 1)

        points, self._vertex = torch.unique(mesh.vertices.detach(), dim=0, return_inverse=True)
        corners = self._vertex[mesh.faces.long()]
        shown = points[corners]  # vertices of no face have no part in where the mesh is and how large
        low, high = shown.amin((0, 1)), shown.amax((0, 1))
        self._centre, self._scale = (low + high) / 2, float((high - low).max()) / 2
        if not self._scale:
            raise ValueError("mesh: expected one of some size, got faces whose vertices all coincide")
        self._start = (points - self._centre) / self._scale
        self._vertices = self._start.clone().requires_grad_()

        self._paint: Paint
        if isinstance(mesh, UVMesh):
            self._paint = ImagePaint(mesh, corners)
        else:
            self._paint = FacePaint(mesh, corners, texture_size, seamless)
        self._topology = Topology.of(corners)
        colours = self._begun(start, mesh.vertices.device)
        self._colours = torch.logit(colours.clamp(_DARKEST, 1 - _DARKEST)).requires_grad_()
        rates = {"vertex_rate": vertex_rate, "texture_rate": texture_rate}
        self._rates = [validate.not_negative(name, rate) for name, rate in rates.items()]
        self._unpainted = start == "mesh" and not self._rates[1]  # then its colours need not be within reach of others
        groups = zip((self._vertices, self._colours), self._rates, strict=True)
        self._optimizer = Adam([{"params": [parameter], "lr": rate} for parameter, rate in groups])
        self._settle = validate.number("settle", settle)
        if not 0 <= self._settle <= 1:
            raise ValueError(f"settle: expected a part in [0, 1], got {settle}")
        self._seen = torch.zeros(self._paint.count, dtype=torch.int32, device=self._colours.device)
        self.seconds = {"renderer": 0.0, "network": 0.0, "rest": 0.0}
        """Where the time of the steps went: drawing and its gradient; the objective and its; the rest."""
        self._before: float | None = None

    @property
    def before(self) -> float:
        """`measure` before the first step."""
        if self._before is None:
            self._before = self.measure()
        return self._before

    @property
    def done(self) -> bool:
        """Whether all steps are taken."""
        return self.step >= self.steps

    def mesh(self) -> Mesh | UVMesh:
        """The mesh as it is now, in its own world; texels that hardly a view has shown take on the colours around."""
        vertices = self._vertices.detach()[self._vertex] * self._scale + self._centre
        if self._unpainted:
            mesh = self._paint.unpainted(vertices)
            return mesh if isinstance(mesh, UVMesh) else Mesh(*mesh)
        often = self._seen > _SELDOM * self.step
        return self._paint.finished(vertices, torch.sigmoid(self._colours.detach()), often)

    def moved(self) -> dict[str, float]:
        """How far the vertices are from their start, the mean and the most, as parts of the mesh's longest side."""
        distance = (self._vertices.detach() - self._start).norm(dim=1) / 2
        return {"mean": distance.mean().item(), "most": distance.max().item()}

    def advance(self) -> dict[str, float]:
        """Take one step; returns the losses before it, each with its weight, and their sum ``loss``."""
        _ = self.before  # now or never
        clock = _Clock(self._vertices.device)
        random = generator(self._seed, self.step)
        camera, light = self._views.sample(self._batch, random)
        background = self._objective.background(self._batch, random)
        mesh = self._drawn()
        begun = clock()
        images = self._draw(mesh, camera, light, background)
        drawn = clock()
        rgb, alpha = images.rgb, images.alpha
        pixels = rgb.detach().requires_grad_()  # type: ignore[union-attr]
        deformation = Deformation(self._vertices, self._start, self._topology)
        parts = self._objective.losses(pixels, alpha.detach(), deformation)  # type: ignore[union-attr]
        loss = torch.stack(list(parts.values())).sum()
        self._optimizer.zero_grad()
        loss.backward()
        judged = clock()
        rgb.backward(pixels.grad)  # type: ignore[union-attr]
        returned = clock()
        self._adapt()
        if self._colours.grad is not None:
            self._seen += (self._colours.grad != 0).any(1)
        self.step += 1
        self.seconds["renderer"] += drawn - begun + returned - judged
        self.seconds["network"] += judged - drawn
        self.seconds["rest"] += begun - clock.start + clock() - returned
        return {"loss": loss.item(), **{name: part.item() for name, part in parts.items()}}

    def measure(self) -> float:
        """The objective on eight views all around that are no steps' own, averaged."""
        camera, light = self._views.fixed(_HELD_OUT, offset=11.0)
        background = self._objective.background(_HELD_OUT, generator(-1, 0))
        with torch.no_grad():
            images = self._draw(self._drawn(), camera, light, background)
            found = [
                self._objective.measure(rgb, alpha)
                for rgb, alpha in zip(images.rgb.split(self._batch), images.alpha.split(self._batch), strict=True)  # type: ignore[union-attr]
            ]
        return torch.cat(found).mean().item()

    def state_dict(self) -> dict[str, Any]:
        """All that changes from step to step."""
        return {
            "step": self.step,
            "vertices": self._vertices.detach(),
            "colours": self._colours.detach(),
            "seen": self._seen,
            "optimizer": self._optimizer.state_dict(),
            "seconds": dict(self.seconds),
            "before": self.before,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` of an edit of the same mesh was taken; ValueError if that is beyond ``steps``."""
        if state["step"] > self.steps:
            raise ValueError(f"steps: expected at least the {state['step']} that are taken already, got {self.steps}")
        with torch.no_grad():
            self._vertices.copy_(state["vertices"])
            self._colours.copy_(state["colours"])
            self._seen.copy_(state["seen"])
        self._optimizer.load_state_dict(state["optimizer"])
        self.step, self._before = state["step"], state["before"]
        self.seconds = dict(state["seconds"])

    def _adapt(self) -> None:
        """A step of the optimiser, at the rates of this time."""
        left = (self.steps - self.step) / self.steps
        for group, rate in zip(self._optimizer.param_groups, self._rates, strict=True):
            group["lr"] = rate * min(1.0, left / max(self._settle, 1e-9))
        self._optimizer.step()

    def _drawn(self) -> UVMesh | tuple[Tensor, ...]:
        """The mesh in [-1, 1]³ or near, as it is drawn."""
        vertices = self._vertices[self._vertex]
        if self._unpainted:
            return self._paint.unpainted(vertices)
        return self._paint.drawn(vertices, torch.sigmoid(self._colours))

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

    def _begun(self, start: str, device: torch.device) -> Tensor:
        """The colours [count, 3] to begin with."""
        if start in ("plain", "random"):
            noise = torch.randn(self._paint.count, 3, generator=torch.Generator().manual_seed(self._seed)).to(device)
            plain = self._objective.plain.to(device).clamp(_DARKEST, 1 - _DARKEST)
            return torch.sigmoid((torch.logit(plain) if start == "plain" else 0) + 0.05 * noise)
        if start != "mesh":
            raise ValueError(f'start: expected "mesh", "plain" or "random", got {start!r}')
        return self._paint.first()


class _Clock:
    """Seconds since any time, when the device has done what it was told."""

    def __init__(self, device: torch.device) -> None:
        self._device = device
        self.start = self()

    def __call__(self) -> float:
        if self._device.type == "cuda":
            torch.cuda.synchronize(self._device)
        return time.perf_counter()
