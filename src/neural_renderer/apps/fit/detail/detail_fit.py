"""`DetailFit`: details of a shape from normals, depth and colours, with continuous remeshing."""

from __future__ import annotations

from typing import Any, Literal

import torch
import torch.nn.functional as F
from torch import Tensor

from ....base import validate
from ....meshes.normals import face_normals, vertex_normals
from ...common.adjustable import Adjustable
from ...common.views.views import Views, mask_iou, photos_of, views_of_step
from ..settings import DETAIL_STEPS
from ..weights import DetailWeights
from .adaptive_descent import AdaptiveDescent
from .color_model import ColorModel, roughness
from .pyramid import Pyramid, shortest_edge

_LONGEST = 0.15  # target length of edges, where the object is about 2 long
_DECAY_FROM = 0.7  # fraction of the steps after which the rate decreases
# Smooth normals move the surface far, but hide zigzags of adjacent faces. After this fraction of the steps, flat (face)
# normals replace them.
_FLAT_FROM = 0.4
_COLOR_RATE = 0.02  # step of the albedo
_SETTLE = 10  # steps of light and albedo before vertices move by colours
# See `AdaptiveDescent.step`. Colours are less informative than normals: where they have little contrast, vertices move
# little, and noise becomes lumps, unless vertices are smoothed four times as much.
_FLOOR, _REACH, _SMOOTHER = 0.5, 1.0, 4.0
_FINER = 2 / 3  # least target length of edges for colours, relative to that for normals
# Between these numbers of views, edges shrink with the root of the number, so that faces have as many pixels. Smoothing
# shrinks with them, and steps without anti-aliasing with the faces: a face below a pixel needs several samples.
_FEW, _MANY = 24, 66
# A view with a known mask counts as this many. Shadows and noise in few views make false creases, so each step moves
# the surface by this share of the way to a fairer one; many views show which creases are true.
_KNOWN, _FAIR = 3, 0.5
_TRUST = 0.1  # weight of masks where colours separate the object from a known background
_SMOOTH_FROM = 0.85  # fraction of the steps after which images are anti-aliased, which takes three times as long
# With more views than `_FEW` faces stay as they are after this fraction of the steps: vertices and colours move, by
# squared differences, as of a PSNR. Steps are as long as this share of those before.
_FIXED_FROM, _FIXED_RATE = 0.7, 1 / 3
# These fits start with pictures of at least so many pixels. Edges grow to at most so many times the shortest one there:
# vertices of flat parts with a pattern move steadily, so that their faces would become large.
_LEAST_OF_MANY, _LONGEST_OF_MANY = 96, 1.5


class DetailFit(Adjustable):
    """Fit the details of a shape to silhouettes with normals, depth or colours. Call `advance` until ``done``.

    Each step draws some views, from coarse to fine. The loss is the mean absolute difference of each map. Views with
    backgrounds are compared with whole photographs, so that colours move outlines; masks then count a tenth. Vertices
    move, and the mesh is remeshed, after Palfinger's "Continuous remeshing for inverse rendering" (2022): faces are
    large where the surface still moves, and shrink to edges of 3 pixels where detail is missing; for colours to 2, and
    to 1.2 if there are many views or masks are known, which are anti-aliased earlier then. Where masks are known, up to
    24 views with a fitted light make the surface fairer, so that noise and shadows are no creases; with more views the
    last three tenths of the steps keep the faces, and minimise squared differences on black and on white.

    Args:
        views: Views that are `Views.normalized`, so that the object lies in about [-1, 1]³.
        vertices: [V, 3] float32, initial positions, for example of a sphere.
        faces: [F, 3], whole numbers of any real dtype; counter-clockwise seen from outside.
        steps: Number of steps, ≥ 1.
        edge_length: Least target length of edges; None is 3 pixels, and for colours less.
        weights: Weights of the losses.
        rate: Length of a steady step of a vertex, relative to the length of the edges around it, > 0.
        batch: Views per step, ≥ 1.
        seed: Seed of the order of the views.
        light: None: colours do not count. "fitted": colours are albedo times one light for all photos; both are fitted.
            "none": no light model, for surfaces whose colours are the same in all photos, or differ too much.

    Raises:
        TypeError, ValueError: An argument does not fit.

    Example:
        >>> from neural_renderer.apps.fit import DetailFit, Views
        >>> eyes = nr.get_points_from_angles(3.0, 20.0, torch.arange(6) * 60.0)
        >>> camera = nr.Camera.look_at(eyes, viewing_angle=25)
        >>> views = Views.of(nr.Mesh.icosphere(3), camera, size=32, normals=True)
        >>> fit = DetailFit(views, *nr.icosphere(2, radius=0.8), steps=4)
        >>> torch.save(fit.state_dict(), "start.pt")
        >>> while not fit.done:
        ...     numbers = fit.advance()
        ...     fit.adjust("normals", 2.0)
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
        steps: int = DETAIL_STEPS,
        edge_length: float | None = None,
        weights: DetailWeights = DetailWeights(),  # noqa: B008 (immutable)
        rate: float = 0.3,
        batch: int = 4,
        seed: int = 0,
        light: Literal["fitted", "none"] | None = None,
    ) -> None:
        if views.normals is None and views.depth is None and light is None:
            raise ValueError("views: expected normals or depth, got neither")
        self.steps, self.step = validate.whole("steps", steps, 1), 0
        self._count, self._will_settle = len(views), settles(views, len(views))
        self._least = None if edge_length is None else validate.positive("edge_length", edge_length)
        self._weights, self._rate = weights, validate.positive("rate", rate)
        self._batch, self._seed = min(validate.whole("batch", batch, 1), len(views)), seed
        self._light = light
        self._is_colored, self._is_known = views.normals is None and views.depth is None, _follows_masks(views)
        self._fewer = fewer(self._count * (_KNOWN if self._is_known else 1)) if self._is_colored else 1.0
        self._finer = _FINER * self._fewer if self._is_colored else 1.0
        self._color = None if light is None else ColorModel(views, light)
        colors = None if self._color is None else self._color.mean.expand(len(vertices), -1)
        self._descent = AdaptiveDescent(vertices.float(), faces, colors)
        self._edges = float(self._descent.surface.target.mean())  # at the start, which chooses the levels
        self._pyramid = self._levels(views)
        is_limited = self._will_settle and self._least is None
        smallest = self._pyramid.at(0.0)
        self._most = _LONGEST_OF_MANY * self._finer * shortest_edge(smallest) if is_limited else _LONGEST

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
        level = self._pyramid.at(progress / _FIXED_FROM if self._will_settle else progress)
        views = level[views_of_step(self._count, self._batch, self._seed, self.step)]
        parameters = [self._descent.vertices.clone().requires_grad_()]
        if self._color is not None:
            parameters.append(self._descent.colors.clone().requires_grad_())
        is_fixed = self._will_settle and progress >= _FIXED_FROM
        anti_aliasing = is_fixed or progress >= _SMOOTH_FROM * self._fewer**2
        parts, iou = self._losses(views, parameters, progress >= _FLAT_FROM, anti_aliasing, is_fixed)
        loss = torch.stack([getattr(self._weights, name) * part for name, part in parts.items()]).sum()
        gradients = torch.autograd.grad(loss, parameters)
        decay = min(1.0, (1 - progress) / (1 - _DECAY_FROM) * (2 if is_fixed else 1))
        if is_fixed and (self.step - 1) / self.steps < _FIXED_FROM:  # the first such step
            self._descent.forget()
        if self._color is not None:
            self._descent.step_colors(gradients[1], _COLOR_RATE * decay, _FLOOR if is_fixed else 0.0)
        if self._color is None or self.step >= min(_SETTLE, self.steps // 4):
            least = self._finer * shortest_edge(views) if self._least is None else self._least
            options = {"rate": self._rate * decay, "smooth": self._weights.smooth * decay, "most": self._most}
            if self._is_known and self._light == "fitted" and not self._will_settle:
                options |= {"fair": _FAIR * decay}
            if self._is_colored:
                options |= {
                    "floor": _FLOOR,
                    "reach": _REACH,
                    "smooth": min(_SMOOTHER * self._fewer * self._weights.smooth, 1.0) * decay,
                }
            if is_fixed:
                options |= {"rate": _FIXED_RATE * options["rate"], "smooth": 0.0, "fixed": True}
            self._descent.step(gradients[0], least=least, **options)
        self.step += 1
        return {"loss": loss.item(), "iou": iou.item(), **{name: part.item() for name, part in parts.items()}}

    def _losses(
        self, views: Views, parameters: list[Tensor], flat: bool, anti_aliasing: bool, squared: bool
    ) -> tuple[dict[str, Tensor], Tensor]:
        """Compute the parts of the loss, and the mean silhouette IoU."""
        vertices, faces = parameters[0], self._descent.faces
        seen = views.fragments((vertices, faces), anti_aliasing)
        if flat:
            normals = -face_normals(_corners_of(vertices, faces))[:, None].expand(-1, 3, -1)
        else:
            normals = _corners_of(vertex_normals(vertices, faces)[0], faces)
        layers = {"silhouette": (seen.face_index >= 0).to(vertices)[..., None]}
        targets = {"silhouette": views.masks[:, None]}
        trust: float | Tensor = 1.0
        if views.normals is not None or views.depth is not None:
            eyes, forward = views.eyes()
            depth = ((vertices - eyes[:, None]) * forward[:, None]).sum(2, keepdim=True)
            surface = seen.interpolate(torch.cat((normals.expand(len(views), -1, -1, -1), depth[:, faces]), 3))
            if views.normals is not None:
                layers["normals"], targets["normals"] = F.normalize(surface[..., :3], dim=3), views.normals
            if views.depth is not None:
                # The difference is composited, so that a part which appears or vanishes contributes no error.
                layers["depth"], targets["depth"] = _depth_error(surface[..., 3:], views.depth), torch.zeros(())
        if self._color is not None:
            albedo = _corners_of(parameters[1], faces)
            # In small pictures, faces would turn until their shading were the pattern of the surface.
            shaded = normals.detach() if self._will_settle and views.size != self._full.size else normals
            layers["photometric"] = self._color.draw(views, seen, albedo, shaded, not anti_aliasing)
            targets["photometric"] = photos_of(views)
        if self._color is not None and views.scenes is not None and views.backgrounds is not None:
            # A picture is background + coverage · (object - background).
            known, background = views.backgrounds.isfinite(), views.backgrounds.nan_to_num(0.0)
            layers["photometric"] = layers["photometric"] - _enlarged(background.movedim(1, 3), layers["photometric"])
            targets["photometric"] = torch.where(known, views.scenes - background, targets["photometric"])
            trust = torch.where(known[:, 0], _TRUST, 1.0)
        sizes = [part.shape[3] for part in layers.values()]
        drawn = seen.composite(torch.cat(list(layers.values()), 3), seams=flat)  # normals of faces jump at edges
        images = dict(zip(layers, drawn.split(sizes, 1), strict=True))
        errors = {name: image - targets[name].to(image) for name, image in images.items()}
        if squared:  # photographs on black, and on white in place of silhouettes
            errors["silhouette"] = errors["photometric"] - errors["silhouette"]
        errors = {name: (error.square() if squared else error.abs()).sum(1) for name, error in errors.items()}
        errors["silhouette"] = trust * errors["silhouette"]
        losses = {name: error.mean() for name, error in errors.items()}
        if self._color is not None and not squared:
            losses["albedo"] = roughness(albedo)
        return losses, mask_iou(images["silhouette"][:, 0], views.masks).mean()

    def _levels(self, views: Views) -> Pyramid:
        """Choose the levels of full-size views."""
        return Pyramid(views, torch.inf, _LEAST_OF_MANY) if self._will_settle else Pyramid(views, self._edges)

    @property
    def _full(self) -> Views:
        """All views at full size."""
        return self._pyramid.at(1.0)

    def state_dict(self) -> dict[str, Any]:
        vertices, faces = self.shape
        state = {"step": self.step, "vertices": vertices, "faces": faces, "edges": self._edges}
        color = None if self._color is None else self._color.state_dict()
        return state | {"descent": self._descent.state_dict(), "color": color}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.step, self._edges = state["step"], state["edges"]
        self._pyramid = self._levels(self._full)
        self._descent.load_state_dict(state["descent"])
        if self._color is not None:
            self._color.load_state_dict(state["color"])


def settles(views: Views, count: int) -> bool:
    """Return whether the last steps keep the faces: for colours of ``count`` views, many, whose masks are known."""
    return count > _FEW and _follows_masks(views)


def _follows_masks(views: Views) -> bool:
    """Return whether details come from colours, and outlines from known masks: with backgrounds, colours move them."""
    return views.normals is None and views.depth is None and views.backgrounds is None


def fewer(count: int) -> float:
    """Return the factor for edges and smoothing, and for the root of the steps before anti-aliasing, by the views."""
    return (_FEW / min(max(count, _FEW), _MANY)) ** 0.5


def _corners_of(values: Tensor, faces: Tensor) -> Tensor:
    """Gather values [V, C] at the corners of faces, [F, 3, C]; its gradient is faster than that of indexing."""
    return values.index_select(0, faces.flatten()).unflatten(0, faces.shape)


def _depth_error(depth: Tensor, target: Tensor) -> Tensor:
    """Subtract known depth [N, H, W] from the depth of fragments, [N, H, W, 1] or twice as large; 0 if unknown."""
    target = _enlarged(target[..., None], depth)
    return torch.where(target > 0, depth - target, 0.0)


def _enlarged(image: Tensor, fragments: Tensor) -> Tensor:
    """Repeat the pixels of images [N, H, W, C] to the size of fragments, [N, H, W, C] or twice as large."""
    scale = fragments.shape[1] // image.shape[1]
    return image.repeat_interleave(scale, 1).repeat_interleave(scale, 2)
