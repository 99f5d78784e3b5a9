"""`DetailFit`: details of a shape from normals, depth and colours, with remeshing on the way."""

from __future__ import annotations

from typing import Any, Literal

import torch
import torch.nn.functional as F
from torch import Tensor

from .... import validate
from ....deferred import Fragments
from ....meshes.normals import face_normals, vertex_normals
from ...settings import DetailWeights
from ..adjustable import Adjustable
from ..fit_views import Views, mask_iou, views_of_step
from .adaptive_descent import AdaptiveDescent
from .light_fit import LightFit
from .pyramid import Pyramid, shortest_edge

_LONGEST = 0.15  # target length of edges, where the object is about 2 long
_DECAY_FROM, _LAST_RATE = 0.7, 0.05  # the rate decreases from this fraction of the steps on, to this share
# Smooth normals move the surface far, but do not notice neighbouring faces that are bent to and fro. So from this
# fraction of the steps on, normals are those of faces.
_FLAT_FROM = 0.4
_COLOR_RATE = 0.02  # of albedo
_SETTLE = 10  # steps of light and albedo before vertices move by colours
_PX=1.0
_REACH=0.0
_FLOOR = 1.0  # see `AdaptiveDescent.step`: where colours say little, vertices move little
_INSIDE = 0.999  # mask of pixels that tell the light
_SMOOTH_FROM = 0.85  # fraction of the steps from which images are anti-aliased, which takes thrice the time


class DetailFit(Adjustable):
    """Fit the details of a shape to silhouettes with normals, depth or colours. Call `advance` until ``done``.

    Each step draws some views, from coarse to fine. The loss is the mean absolute difference of each map. Vertices
    move, and the mesh is remeshed, after Palfinger's "Continuous remeshing for inverse rendering" (2022): faces are
    large where the surface still moves, and shrink to edges of 3 pixels where detail is missing.

    Args:
        views: Views that are `Views.normalized`, so that the object lies in about [-1, 1]³.
        vertices: [V, 3] float32, initial positions, for example of a sphere.
        faces: [F, 3], whole numbers of any real dtype; counter-clockwise seen from outside.
        steps: Number of steps, ≥ 1.
        edge_length: Least target length of edges; None is 3 pixels.
        weights: Weights of the losses.
        rate: Length of a steady step of a vertex, relative to the length of the edges around it, > 0.
        batch: Views per step, ≥ 1.
        seed: Seed of the order of the views.
        light: None: colours do not count. "fitted": colours are albedo times a light that is the same in all photos,
            and both are fitted along. "none": colours of the surface are the same in all photos, or differ too much.

    Raises:
        TypeError, ValueError: An argument does not fit.

    Example:
        >>> from neural_renderer.tasks.fit import DetailFit, Views
        >>> eyes = nr.get_points_from_angles(3.0, 20.0, torch.arange(6) * 60.0)
        >>> camera = nr.Camera.look_at(eyes, viewing_angle=25)
        >>> views = Views.of(nr.Mesh.icosphere(3), camera, size=32, normals=True)
        >>> fit = DetailFit(views, *nr.icosphere(2, radius=0.8), steps=4)
        >>> torch.save(fit.state_dict(), "start.pt")
        >>> while not fit.done:
        ...     numbers = fit.advance()
        ...     fit.turn("normals", 2.0)
        >>> vertices, faces = fit.shape[:2]
        >>> [knob.name for knob in fit.knobs()][:2]
        ['rate', 'silhouette']
        >>> fit.load_state_dict(torch.load("start.pt"))  # back to the start
    """

    def __init__(
        self,
        views: Views,
        vertices: Tensor,
        faces: Tensor,
        *,
        steps: int = 200,
        edge_length: float | None = None,
        weights: DetailWeights = DetailWeights(),  # noqa: B008 (immutable)
        rate: float = 0.3,
        batch: int = 4,
        seed: int = 0,
        light: Literal["fitted", "none"] | None = None,
    ) -> None:
        if light not in (None, "fitted", "none"):
            raise ValueError(f'light: expected "fitted", "none" or None, got {light!r}')
        if light is not None and views.photos is None:
            raise ValueError(f"light: expected None for views without photos, got {light!r}")
        if views.normals is None and views.depth is None and light is None:
            raise ValueError("views: expected normals or depth, got neither")
        self.steps, self.step = validate.whole("steps", steps, 1), 0
        self._count = len(views)
        self._least = None if edge_length is None else validate.positive("edge_length", edge_length)
        self._weights, self._rate = weights, validate.positive("rate", rate)
        self._batch, self._seed = min(validate.whole("batch", batch, 1), len(views)), seed
        colors = None
        if light is not None:
            colors = (views.photos.sum((0, 2, 3)) / views.masks.sum()).expand(len(vertices), -1)  # type: ignore[union-attr]
        self._descent, self._has_colors = AdaptiveDescent(vertices.float(), faces, colors), colors is not None
        self._light = LightFit(views.masks) if light == "fitted" else None
        self._pyramid = Pyramid(views, float(self._descent.surface.target.mean()))

    @property
    def done(self) -> bool:
        """Whether all steps are taken."""
        return self.step >= self.steps

    @property
    def shape(self) -> tuple[Tensor, ...]:
        """Current vertices and faces, in the form of `render`."""
        return self._descent.vertices, self._descent.faces

    def advance(self) -> dict[str, float]:
        """Take one step.

        Returns:
            "loss" and "iou", the mean silhouette IoU of the views of the step, both before it; and the parts of the
            loss by name.
        """
        progress = self.step / self.steps
        views = self._pyramid.at(progress)[views_of_step(self._count, self._batch, self._seed, self.step)]
        parameters = [self._descent.vertices.clone().requires_grad_()]
        if self._has_colors:
            parameters.append(self._descent.colors.clone().requires_grad_())
        parts, iou = self._losses(views, parameters, progress >= _FLAT_FROM, progress >= _SMOOTH_FROM)
        loss = torch.stack([getattr(self._weights, name) * part for name, part in parts.items()]).sum()
        gradients = torch.autograd.grad(loss, parameters)
        decay = min(1.0, max(_LAST_RATE, (1 - progress) / (1 - _DECAY_FROM)))
        if self._has_colors:
            self._descent.step_colors(gradients[1], _COLOR_RATE * decay)
        least = shortest_edge(views) if self._least is None else self._least
        if self._has_colors: least=least*_PX
        if not self._has_colors or self.step >= min(_SETTLE, self.steps // 4):
            rate, smooth = self._rate * decay, self._weights.smooth * decay
            floor = _FLOOR if self._has_colors else 0.0
            self._descent.step(gradients[0], rate=rate, smooth=smooth, least=least, most=_LONGEST, floor=floor, reach=_REACH if self._has_colors else 0.0)
        self.step += 1
        return {"loss": loss.item(), "iou": iou.item(), **{name: part.item() for name, part in parts.items()}}

    def _losses(
        self, views: Views, parameters: list[Tensor], flat: bool, anti_aliasing: bool
    ) -> tuple[dict[str, Tensor], Tensor]:
        """Compute the parts of the loss, and the mean silhouette IoU."""
        vertices, faces = parameters[0], self._descent.faces
        seen = views.fragments((vertices, faces), anti_aliasing)
        if flat:
            normals = -face_normals(vertices[faces])[:, None].expand(-1, 3, -1)
        else:
            normals = vertex_normals(vertices, faces)[0][faces]
        layers = {"silhouette": (seen.face_index >= 0).to(vertices)[..., None]}
        targets = {"silhouette": views.masks[:, None]}
        if views.normals is not None or views.depth is not None:
            eyes, forward = views.eyes()
            depth = ((vertices - eyes[:, None]) * forward[:, None]).sum(2, keepdim=True)
            surface = seen.interpolate(torch.cat((normals.expand(len(views), -1, -1, -1), depth[:, faces]), 3))
            if views.normals is not None:
                layers["normals"], targets["normals"] = F.normalize(surface[..., :3], dim=3), views.normals
            if views.depth is not None:
                # Composited as a difference: a part that appears or vanishes has no error at all.
                layers["depth"], targets["depth"] = _depth_error(surface[..., 3:], views.depth), torch.zeros(())
        if self._has_colors:
            layers["photometric"] = self._colors(views, seen, parameters[1][faces], normals, anti_aliasing)
            targets["photometric"] = views.photos  # type: ignore[assignment]
        sizes = [part.shape[3] for part in layers.values()]
        drawn = seen.composite(torch.cat(list(layers.values()), 3), seams=flat)  # normals of faces jump at edges
        images = dict(zip(layers, drawn.split(sizes, 1), strict=True))
        losses = {name: (image - targets[name].to(image)).abs().sum(1).mean() for name, image in images.items()}
        if self._has_colors:
            losses["albedo"] = _roughness(parameters[1], faces)
        return losses, mask_iou(images["silhouette"][:, 0], views.masks).mean()

    def _colors(self, views: Views, seen: Fragments, albedo: Tensor, normals: Tensor, anti_aliasing: bool) -> Tensor:
        """Compute the colours of pixels [N, h, w, 3] from albedo and normals of corners, both [F, 3, 3]."""
        if self._light is not None:
            if not anti_aliasing:
                self._light.add(*_pixels(views, seen, albedo.detach(), normals.detach()))
            albedo = albedo * self._light.on(normals)
        colors = seen.interpolate(albedo[None])
        return colors if views.gains is None else colors * views.gains[:, None, None]

    def state_dict(self) -> dict[str, Any]:
        """Collect everything that changes from step to step.

        Returns:
            Numbers and tensors by name, for `load_state_dict`. Later steps may change them; `torch.save` copies them.
        """
        vertices, faces = self.shape
        state = {"step": self.step, "vertices": vertices, "faces": faces}
        light = None if self._light is None else self._light.state_dict()
        return state | {"descent": self._descent.state_dict(), "light": light}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Resume from the state of a fit of the same views.

        Args:
            state: Result of `state_dict`.

        Raises:
            KeyError: A name is missing.
        """
        self.step = state["step"]
        self._descent.load_state_dict(state["descent"])
        if self._light is not None:
            self._light.load_state_dict(state["light"])


def _depth_error(depth: Tensor, target: Tensor) -> Tensor:
    """Subtract known depth [N, H, W] from that of fragments, [N, H, W, 1] or twice as large; 0 where none is known."""
    scale = depth.shape[1] // target.shape[1]
    target = target.repeat_interleave(scale, 1).repeat_interleave(scale, 2)[..., None]
    return torch.where(target > 0, depth - target, 0.0)


def _pixels(views: Views, seen: Fragments, albedo: Tensor, normals: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Collect normals, albedo and colours [P, 3] of the pixels inside of masks, from those of corners [F, 3, 3]."""
    photos = views.photos if views.gains is None else views.photos / views.gains[:, :, None, None]  # type: ignore
    inside = (seen.face_index >= 0) & (views.masks > _INSIDE)
    shown = seen.face_index[inside].long()
    return F.normalize(normals.mean(1), dim=1)[shown], albedo.mean(1)[shown], photos.movedim(1, 3)[inside]  # type: ignore[union-attr]


def _roughness(colors: Tensor, faces: Tensor) -> Tensor:
    """Average the absolute differences of colours [V, C], summed over the channels, along the edges of faces."""
    return (colors[faces] - colors[faces.roll(1, 1)]).abs().sum(2).mean()
