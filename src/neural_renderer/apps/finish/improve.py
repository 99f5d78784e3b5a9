"""`Improvement`: descent on the difference between drawings of the original and of the small mesh."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor

from ...base import validate
from ...meshes.uv_mesh import UVMesh
from ...raster.outputs import Images
from ...rendering.deferred import fragments
from ...shading.lights import Light
from ...textures.sample_texture import sample_texture
from ..common.adjustable import Resumable
from ..common.geometry.edges import areas
from ..common.observer import Knob
from ..compare.stage import Stage, errors_of_sums, sums_of_errors
from .layout import Layout
from .pictures import Outlines, Target, draw_target
from .source import NORMAL
from .surface.folds import without_folds
from .transfer import filled
from .workshop import Level, Workshop

SHAPE, IMAGES = "vertices", "images"
"""Phases of an improvement."""
HELD_OUT = 8
"""Views that measure a mesh and do not improve it."""
_TOGETHER = 4  # views of a step of images
_OUTLINES = 3  # silhouettes that move the vertices, for each view of the images
_OUTLINES_TOGETHER = 12  # silhouettes of a move
_MOVES = 6  # moves of the vertices in a step, which cost less than one of the images
_RATE = 0.007  # length of the first move, relative to the mean edge
_RELAXATION = 0.8  # share of the correction of images that a step applies
_SOLID = 0.999  # coverage of pixels whose looks are compared
_LEAST_WEIGHT = 0.05  # weight of the views below which a texel is corrected less
_MOST_DECIBELS = 120.0  # of equal pictures
_LIGHTS = (
    Light(0.3, 0.7, direction=(0.5, 0.7, 0.5)),
    Light(0.4, 0.6, direction=(-0.6, 0.3, -0.7)),
)


class Improvement(Resumable):
    """Moves vertices by the silhouettes of the original, then corrects the images by what its views show.

    After the vertices, and each time that all views have corrected the images, the result is kept only if the PSNR of
    pictures that did not take part grows; images that do not gain end the improvement.
    """

    def __init__(self, workshop: Workshop, level: Level, steps: int, views: int, pixels: int) -> None:
        self._workshop, self.level, self._pixels = workshop, level, pixels
        images = 0 if level.painted is None else steps - steps // 2
        self._counts = {SHAPE: steps - images, IMAGES: images}
        self.phase, self.step = SHAPE if steps > images else IMAGES, 0
        source = workshop.source
        stage = Stage.around(source.drawn, views + HELD_OUT, pixels, shading="pbr")
        chosen = torch.linspace(0, views + HELD_OUT - 1, HELD_OUT).round().long()
        is_held = torch.zeros(views + HELD_OUT, dtype=torch.bool)
        is_held[chosen] = True
        held, fitted = (torch.nonzero(rows)[:, 0].tolist() for rows in (is_held, ~is_held))
        self._stage, self._held, self._fitted = stage, held, fitted
        self._pictures: list[Images] = []
        self._targets: dict[int, Target] = {}
        self.measured: dict[str, Any] = {}
        self._moves = torch.zeros_like(level.mesh.vertices).requires_grad_()
        self._outlines: tuple[Outlines, Outlines] | None = None
        self._best: tuple[float, Tensor] | None = None
        self._looks: Tensor | None = None
        self._views: dict[int, tuple[Any, Tensor]] = {}

    @property
    def steps(self) -> int:
        """Steps of the current phase."""
        return self._counts[self.phase]

    @property
    def done(self) -> bool:
        """Whether all steps are taken."""
        return not sum(self._counts.values()) or (self.phase == IMAGES and self.step >= self.steps)

    def knobs(self) -> list[Knob]:
        """List no settings that may change."""
        return []

    def adjust(self, name: str, value: float | str) -> None:
        raise ValueError(f"name: expected no name, for nothing can change, got {name!r}")

    def advance(self) -> dict[str, float]:
        """Take a step; return its loss and the PSNR of the views held out, in dB, where it was measured."""
        if "before" not in self.measured:
            self.measured["before"] = self.measured["best"] = self.measure(self.level.mesh)
        loss = self._move() if self.phase == SHAPE else self._correct()
        self.step += 1
        turn = -(-len(self._fitted) // _TOGETHER)  # steps in which each view had its turn
        if self.step >= self.steps or (self.phase == IMAGES and self.step % turn == 0):
            self._end_turn()
        return {"loss": loss, "psnr": self.measured["best"]["psnr"]}

    def measure(self, mesh: UVMesh) -> dict[str, float]:
        """Compare pictures of the views held out, in two lights: PSNR in dB and intersection over union."""
        if not self._pictures:
            self._pictures = list(self._drawn(self._workshop.source.drawn))
        pairs = zip(self._pictures, self._drawn(mesh), strict=True)
        errors = errors_of_sums(torch.cat([sums_of_errors(original, other) for original, other in pairs]))
        psnr = min(errors.psnr, _MOST_DECIBELS)
        return {"psnr": round(psnr, 3), "iou": round(errors.iou, 5)}

    def _drawn(self, mesh: UVMesh) -> Iterator[Images]:
        for light in _LIGHTS:
            stage = Stage(self._stage.cameras, self._pixels, light, "pbr")
            for view in self._held:
                yield stage.draw(mesh, view)

    @functools.cached_property
    def _optimizer(self) -> torch.optim.Optimizer:  # its first use imports torch's compiler, which takes seconds
        return torch.optim.Adam([self._moves], lr=1.0, betas=(0.9, 0.99))

    def _target(self, view: int) -> Target:
        if view not in self._targets:
            shop = self._workshop
            camera = self._stage.cameras[view]
            self._targets[view] = draw_target(shop.source, camera, self._pixels)
        return self._targets[view]

    def _of_step(self) -> list[int]:
        """Choose the views of a step: all of them in turn."""
        count = len(self._fitted)
        first = self.step * _TOGETHER
        return [self._fitted[(first + number) % count] for number in range(min(_TOGETHER, count))]

    def _move(self) -> float:
        """Move vertices so that silhouettes fit those of the original."""
        fitted, held = self._both_outlines()
        mesh = self.level.mesh
        edge = (2.3 * float(areas(mesh.vertices[mesh.faces.long()]).mean())) ** 0.5  # of an equilateral face
        self._optimizer.param_groups[0]["lr"] = _RATE * edge * (1 - self.step / self.steps)
        total = 0.0
        for number in range(_MOVES):
            generator = torch.Generator().manual_seed(_MOVES * self.step + number)
            views = torch.randperm(len(fitted), generator=generator)[:_OUTLINES_TOGETHER]
            self._optimizer.zero_grad()
            loss = fitted.error(mesh.vertices + self._moves, mesh.faces, views)
            loss.backward()
            self._optimizer.step()
            total += float(loss.detach())
        if self.step % 5 == 4 or self.step + 1 == self.steps:
            with torch.no_grad():
                if self._best is None:
                    self._best = float(held.error(mesh.vertices, mesh.faces)), torch.zeros_like(self._moves)
                error = float(held.error(mesh.vertices + self._moves, mesh.faces))
            if error < self._best[0]:
                self._best = error, self._moves.detach().clone()
        return total / _MOVES

    def _both_outlines(self) -> tuple[Outlines, Outlines]:
        """Draw the silhouettes of the original: those to fit, and the held-out ones."""
        if self._outlines is None:
            shop, count = self._workshop, _OUTLINES * len(self._fitted)
            surface, pixels = (shop.clean.vertices, shop.clean.faces), self._pixels
            around = Stage.around(shop.source.drawn, count, pixels).cameras
            held = self._stage.cameras[self._held]
            self._outlines = Outlines(*surface, around, pixels), Outlines(*surface, held, pixels)
        return self._outlines

    def _correct(self) -> float:
        """Correct the images by the residuals of the views, each spread over the texels that a pixel shows.

        The simultaneous iterative reconstruction technique (Gilbert, 1972): x + Rᵀ(y − R x) / Rᵀ1, with the drawing R.
        """
        if self._looks is None:
            self._looks = filled(*self._painted)
        known = self._looks
        count = known.shape[2]
        image = torch.cat((known, torch.ones_like(known[..., :1])), -1).requires_grad_()
        total, pixels = 0.0, 0
        summed = torch.zeros_like(image)
        for view in self._of_step():
            drawn, places = self._view(view)
            target = self._target(view)
            seen = drawn.composite(sample_texture(image, places, drawn.face_index, wrap="clamp"))[0]
            solid = (seen[-1].detach() > _SOLID) & (target.coverage > _SOLID)
            residual = (target.looks - seen[:count].detach()) * solid
            total, pixels = total + float(residual.square().sum()), pixels + int(solid.sum())
            summed += torch.autograd.grad(seen, image, torch.cat((residual, solid[None].float())))[0]
        weight = summed[..., -1:]
        step = summed[..., :count] / (weight + _LEAST_WEIGHT * weight.mean().clamp(min=1e-9))
        self._looks = (known + _RELAXATION * step).detach()
        return total / max(pixels, 1)

    def _view(self, view: int) -> tuple[Any, Tensor]:
        if view not in self._views:
            mesh = self.level.mesh
            with torch.no_grad():
                drawn = fragments(mesh, self._target(view).camera, self._pixels)
                self._views[view] = drawn, drawn.interpolate(mesh.uv[None])
        return self._views[view]

    def _end_turn(self) -> None:
        """Keep the result if the views held out gain; end the phase after its steps, or if images do not gain."""
        level = self._moved_level() if self.phase == SHAPE else self._corrected_level()
        gains = False
        if level is not None:
            found = self.measure(level.mesh)
            self.measured[self.phase] = found
            gains = found["psnr"] > self.measured["best"]["psnr"]
            if gains:
                self.measured["best"], self.level = found, level
        if self.phase == SHAPE:
            self.phase, self.step, self._looks, self._views = IMAGES, 0, None, {}
        elif not gains:
            self.step = self.steps

    def _moved_level(self) -> Level | None:
        best = self._best
        if best is None or not bool(best[1].any()):
            return None
        old = self.level.mesh
        faces = old.faces.long()
        vertices = without_folds(old.vertices, old.vertices + best[1], faces)
        return self._workshop.moved(self.level, vertices)

    @torch.no_grad()
    def _corrected_level(self) -> Level | None:
        if self._looks is None:
            return None
        looks = self._looks.reshape(-1, self._looks.shape[2])[self._painted[0].texels]
        looks[:, NORMAL] = torch.nn.functional.normalize(looks[:, NORMAL], dim=-1)
        return self._workshop.corrected(self.level, looks)

    @property
    def _painted(self) -> tuple[Layout, Tensor]:
        """The layout of the new images, and the looks of its texels."""
        painted = self.level.painted
        if painted is None:
            raise ValueError("level: expected new images, got those of the original")
        return painted.layout, painted.looks

    def state_dict(self) -> dict[str, Any]:
        return {
            "phase": self.phase,
            "step": self.step,
            "vertices": self.level.mesh.vertices,
            "moves": self._moves.detach(),
            "optimizer": self._optimizer.state_dict(),
            "best": self._best,
            "looks": self._looks,
            "level_looks": None if self.level.painted is None else self.level.painted.looks,
            "measured": dict(self.measured),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Resume from the state of an improvement of the same level; KeyError or ValueError if it does not fit."""
        mesh = self.level.mesh
        if state["vertices"].shape != mesh.vertices.shape:
            got = validate.shape_of(state["vertices"])
            raise ValueError(f"state: expected {len(mesh.vertices)} vertices, got {got}")
        if not torch.equal(state["vertices"], mesh.vertices):
            self.level = self._workshop.moved(self.level, state["vertices"])
        if state["level_looks"] is not None:
            self.level = self._workshop.corrected(self.level, state["level_looks"])
        with torch.no_grad():
            self._moves.copy_(state["moves"])
        self._optimizer.load_state_dict(state["optimizer"])
        self.phase, self.step, self._best = state["phase"], state["step"], state["best"]
        self._looks, self.measured, self._views = state["looks"], dict(state["measured"]), {}
