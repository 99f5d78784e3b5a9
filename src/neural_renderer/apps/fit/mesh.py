"""`MeshFit`: a textured mesh from posed images, in up to four phases: cameras, shape, detail, texture."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import torch
from torch import Tensor

from ...base import validate
from ...camera import Camera
from ...io.files import warn
from ...meshes.mesh import Mesh
from ...meshes.primitives import icosphere
from ...meshes.uv_mesh import UVMesh
from ..common.adjustable import Resumable
from ..common.observer import Knob
from ..common.pictures.clay import plain_texture
from ..common.short_names import short_names
from ..common.views.views import Views
from .agreement import REFINED_MARGIN, check_agreement
from .cameras import CameraRefinement, locate_cameras
from .colors.exposure import estimate_exposure, match_gains, without_vignetting
from .colors.texture import TextureFit
from .detail.color_model import photos_for
from .detail.consistency import mismatch
from .detail.detail_fit import DetailFit, settles
from .detail.whole import cut_out, whole_error
from .hull import carve, carve_levels, object_bounds
from .result import FitResult, judge
from .settings import (
    DETAIL_STEPS,
    MANY_STEPS,
    RECOVER,
    START,
    CameraSettings,
    DescentSettings,
    DetailSettings,
    ShapeSettings,
    TextureSettings,
)
from .shape import ShapeFit, coarse_fit, coarse_hull, coarse_misses

_REFINED_SCALE = 1.05  # scale of the world: the hull of inexact cameras is too small
_REFINED_COLOR_FROM = 0.4  # colours constrain cameras more than outlines
_SPHERE_RADIUS = 0.6
_WORSE = 0.01  # IoU that details from colours may cost
_WORSE_FOUND = 0.03  # the same where outlines come from colours, because masks may be wrong by a pixel
_TEST_EVERY, _TEST_FROM = 8, 16  # of 16 views or more every eighth one tests details from colours
_PACE, _SPHERE_PACE = (0, 0.01), (2, 0.03)  # subdivisions and step size; a sphere is coarse and far from the object


class MeshFit(Resumable):
    """Fit a mesh to posed images: its shape, its details, then its texture. Call `run`, or `advance` until ``done``.

    `result` says whether the mesh matches the images.

    Args:
        views: Views with or without photos, normals and depth. Without photos there is no texture phase.
        start: Initial shape: "hull", the visual hull of the silhouettes; "sphere"; or a `Mesh` or `UVMesh` in the world
            of the cameras.
        recover: "shape" fits shape and texture; "texture" keeps the shape of the given mesh.
        exposure: Whether to fit exposure and white balance of each photo, too: ``views.gains``, whose geometric mean is
            1; and ``vignetting``. They are estimated before each phase in which colours count.
        shape, detail, texture: Settings of the phases. Keywords set single fields, too: ``steps``, ``cells``,
            ``color_from``, ``weights``; ``detail_steps``, ``light``, ``detail_weights``; ``texture_steps``,
            ``texture_size``.
        cameras: Settings for cameras that are not exact; short: ``refine_cameras``, ``camera_steps``.
        descent: Settings of gradient descent; short: ``batch``, ``gradient``, ``seed``.

    Attributes:
        phase: "cameras", "shape", "detail" or "texture".
        vignetting: Logarithm of the brightness of the photos' corners, relative to their middle; 0 if not fitted.

    Raises:
        TypeError, ValueError: An argument does not fit, or the silhouettes have no point in common.

    Example:
        >>> from neural_renderer.apps.fit import MeshFit, Views
        >>> eyes = nr.get_points_from_angles(3.0, 20.0, torch.arange(6) * 60.0)
        >>> views = Views.of(nr.Mesh.icosphere(2), nr.Camera.look_at(eyes, viewing_angle=25), size=32)
        >>> fit = MeshFit(views, cells=16, steps=2, texture_steps=2)
        >>> torch.save(fit.state_dict(), "start.pt")
        >>> while not fit.done:
        ...     losses = fit.advance()
        ...     if fit.phase == "shape":
        ...         fit.adjust("laplacian", 50.0)
        >>> fit.mesh().save("object.glb")
        >>> fit.result()
        FitResult(agreement=0.9..., verdict='match', advice=())
        >>> fit.knobs()  # in the texture phase
        []
        >>> len(fit.cameras())
        6
        >>> iou = fit.normalize(views).quality(fit.shape)["iou"]
        >>> fit.load_state_dict(torch.load("start.pt"))  # back to the start
        >>> fit.skip_to_texture()
        True
        >>> fit.run().verdict
        'match'
    """

    @short_names(
        *("shape.steps", "shape.cells", "shape.color_from", "shape.weights", "detail.light"),
        *("descent.batch", "descent.gradient", "descent.seed"),
        detail_steps="detail.steps",
        detail_weights="detail.weights",
        texture_steps="texture.steps",
        texture_size="texture.size",
        refine_cameras="cameras.refine",
        camera_steps="cameras.steps",
    )
    def __init__(
        self,
        views: Views,
        start: Literal["hull", "sphere"] | Mesh | UVMesh = START,
        *,
        recover: Literal["shape", "texture"] = RECOVER,
        exposure: bool = False,
        shape: ShapeSettings = ShapeSettings(),  # noqa: B008 (immutable, like those below)
        detail: DetailSettings = DetailSettings(),  # noqa: B008
        texture: TextureSettings = TextureSettings(),  # noqa: B008
        cameras: CameraSettings = CameraSettings(),  # noqa: B008
        descent: DescentSettings = DescentSettings(),  # noqa: B008
    ) -> None:
        if recover == "texture" and not isinstance(start, (Mesh, UVMesh)):
            raise ValueError('start: expected a Mesh with recover="texture", got none')
        if recover == "texture" and cameras.refine:
            raise ValueError('refine_cameras: expected False with recover="texture", got True')
        if exposure and views.photos is None:
            raise ValueError("exposure: expected False for views without photos, got True")
        if detail.light is not None:
            photos_for(detail.light, views)
        has_detail = views.normals is not None or views.depth is not None or detail.light is not None
        if detail.steps and not has_detail:
            raise ValueError(
                f"detail_steps: expected 0 for views without normals and depth, and without light, got {detail.steps}"
            )
        self._start, self._exposure = start, validate.flag("exposure", exposure)
        self._shape, self._detail, self._texture, self._descent = shape, detail, texture, descent
        self._detail_steps = DETAIL_STEPS * has_detail if detail.steps is None else detail.steps
        self._coarse_steps = cameras.steps
        default = _REFINED_COLOR_FROM if cameras.refine else 1.0
        self._color_from = default if shape.color_from is None else shape.color_from
        self._center, scale = object_bounds(views, coarse_misses(views) if cameras.refine else 0)
        self._scale = scale * _REFINED_SCALE if cameras.refine else scale
        self._given = views.normalized(self._center, self._scale)
        self._cameras = CameraRefinement(self._given.camera) if cameras.refine else None
        self._gains: Tensor | None = views.gains
        self.vignetting = 0.0
        self._outlines: tuple[Tensor, Tensor] | None = None  # the shape before details from colours
        self._advice: tuple[str, ...] = ()
        self.phase: str = "cameras" if cameras.refine else recover
        self._fit: ShapeFit | DetailFit | TextureFit = self._expose(*self._initial_shape())

    @property
    def views(self) -> Views:
        """The views in a world where the object lies in about [-1, 1]³, with refined cameras and exposure if any."""
        views = self._exposed()
        return views if self._cameras is None else replace(views, camera=self._cameras.camera)

    def _exposed(self) -> Views:
        """Return the given views with gains, and without vignetting."""
        return replace(without_vignetting(self._given, self.vignetting), gains=self._gains)

    @property
    def step(self) -> int:
        """Number of steps taken in this phase."""
        return self._fit.step

    @property
    def steps(self) -> int:
        """Number of steps of this phase."""
        return self._fit.steps

    @property
    def done(self) -> bool:
        """Whether all phases are over."""
        return self._fit.done and self._next_phase() is None

    @property
    def shape(self) -> tuple[Tensor, ...]:
        """Current vertices, faces and, once there are colours, textures, in the world of ``views``."""
        return tuple(part.detach() for part in self._fit.shape)

    def normalize(self, views: Views) -> Views:
        """Convert further views, such as held-out ones, from the world of the cameras to the world of ``views``.

        Args:
            views: Views in the world of the cameras.

        Returns:
            The same views, with other cameras.
        """
        return views.normalized(self._center, self._scale)

    def mesh(self) -> Mesh:
        """Make the current mesh.

        Returns:
            The mesh, in the world of the cameras. A mesh without colours gets the colour of clay.
        """
        vertices, faces, textures = with_texture(self.shape)
        return Mesh(vertices * self._scale + self._center, faces, textures)

    def cameras(self) -> Camera:
        """Make the current cameras, with refinements if any.

        Returns:
            The cameras of the views, in the world of the mesh.
        """
        return self.views.normalized(-self._center / self._scale, 1 / self._scale).camera

    def advance(self) -> dict[str, float]:
        """Take one step.

        Returns:
            "loss" before the step and, but in the texture phase, "iou", the mean silhouette IoU of the views of the
            step.
        """
        following = self._next_phase()
        if self._fit.done and following is not None:
            self._follow(following)
        return self._fit.advance()

    def run(self, held_out: Views | None = None) -> FitResult:
        """Take all remaining steps.

        Args:
            held_out: As in `result`.

        Returns:
            The result.

        Raises:
            ValueError: Cameras are refined and their silhouettes have no point in common any more.
        """
        while not self.done:
            self.advance()
        return self.result(held_out)

    def skip_to_texture(self) -> bool:
        """Leave out the remaining steps before the texture's: the shape stays as it is.

        Returns:
            Whether the fit is in the texture phase now. Views without photos have none.

        Raises:
            ValueError: As `run`.
        """
        if self.phase != "texture" and self.views.photos is not None:
            self._follow("texture")
        return self.phase == "texture"

    def result(self, held_out: Views | None = None) -> FitResult:
        """Measure the current mesh, and judge it. If the fit is done and has failed, look for the cause.

        Args:
            held_out: Views in the world of the cameras that were not fitted, to measure the mesh on them, too; or None.

        Returns:
            The result.

        Raises:
            TypeError, ValueError: As `render`.
        """
        views, shape = self.views, self.shape
        figures = {"fitted": views.quality(shape)}
        if held_out is not None:
            known = self.normalize(held_out)
            figures["held_out"] = known.quality(shape)
            if self._cameras is not None:
                known = locate_cameras(self._cameras.share_lens(known), shape)
                figures["held_out_located"] = known.quality(shape)
            if self._exposure and len(shape) == 3:
                flat = without_vignetting(known, self.vignetting)
                figures["held_out_exposed"] = match_gains(flat, shape).quality(shape)
        agreement, verdict, advice = judge(figures["fitted"]["iou"])
        if self.done and verdict == "mismatch":
            try:
                check_agreement(self._given, margin=1 if self._cameras is None else REFINED_MARGIN)
            except ValueError as error:
                advice = (*advice, str(error))
        return FitResult(self.mesh(), agreement, verdict, (*advice, *self._advice), **figures)

    def knobs(self) -> list[Knob]:
        """List the settings that may change between two steps.

        Returns:
            The knobs of the phase, see `ShapeFit.knobs` and `DetailFit.knobs`; the texture phase has none.
        """
        return [] if isinstance(self._fit, TextureFit) else self._fit.knobs()

    def adjust(self, name: str, value: float | str) -> None:
        if isinstance(self._fit, TextureFit):
            raise ValueError(f"name: expected a setting that can change, got {name!r} in the texture phase")
        self._fit.adjust(name, value)

    def state_dict(self) -> dict[str, Any]:
        cameras = None if self._cameras is None else self._cameras.state_dict()
        state = {"phase": self.phase, "fit": self._fit.state_dict(), "cameras": cameras, "gains": self._gains}
        return state | {"vignetting": self.vignetting, "outlines": self._outlines, "advice": self._advice}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.phase, cameras, self._gains = state["phase"], state["cameras"], state["gains"]
        self._outlines, self._advice, self.vignetting = state["outlines"], state["advice"], state["vignetting"]
        if self._cameras is not None:
            self._cameras.load_state_dict(cameras)
        self._fit = self._start_phase(state["fit"]["vertices"], state["fit"]["faces"])
        self._fit.load_state_dict(state["fit"])

    def _next_phase(self) -> str | None:
        """Name the next phase; None after the last."""
        if self.phase == "cameras":
            return "shape"
        if self.phase == "shape" and self._detail_steps:
            return "detail"
        return "texture" if self.phase != "texture" and self.views.photos is not None else None

    def _follow(self, phase: str) -> None:
        """Begin the next phase with the current shape; after the cameras' phase with a new hull or sphere."""
        vertices, faces, *_ = self.shape
        if self._cameras is not None and self.phase in ("cameras", "shape"):
            vertices = self._cameras.settle(vertices)
        if phase == "detail" and self._detail.light is not None:
            self._outlines = vertices, faces
        elif self.phase == "detail" and self._outlines is not None:
            vertices, faces = self._better(self._outlines, (vertices, faces))
        is_new = self.phase == "cameras" and isinstance(self._start, str)
        self.phase = phase
        self._fit = self._expose(*(self._initial_shape() if is_new else (vertices, faces)))

    def _test_rows(self) -> list[int]:
        """Choose the views held out to test details from colours; none if there are few."""
        return list(range(_TEST_EVERY // 2, len(self._given), _TEST_EVERY)) if len(self._given) >= _TEST_FROM else []

    def _better(self, outlines: tuple[Tensor, Tensor], details: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
        """Choose the shape with details, unless the outlines, or the colours of neighbouring views, match worse.

        Where masks were found, whole photographs of the held-out views test the outlines, if there are such views.
        """
        views, rows = self.views, self._test_rows() or list(range(len(self._given)))
        shapes = outlines, details
        errors = [mismatch(views, rows, *shape) for shape in shapes]
        if views.backgrounds is not None and self._test_rows():
            wholes = [whole_error(views, rows, *shape) for shape in shapes]
            is_kept, what = wholes[1] <= wholes[0], "a difference from whole photographs"
            got = f"{wholes[1]:.4f} after {wholes[0]:.4f}"
        else:
            ious = [float(views[rows].quality(shape)["iou"].mean()) for shape in shapes]
            is_kept, what = ious[1] >= ious[0] - (_WORSE if views.backgrounds is None else _WORSE_FOUND), "a mean IoU"
            got = f"{ious[1]:.3f} after {ious[0]:.3f}"
        if is_kept and errors[1] <= errors[0]:
            return details
        sentence = (
            "details from colours: expected outlines and colours of neighbouring views that match as well as before, "
            f"got {what} of {got} and a mismatch of {errors[1]:.4f} after {errors[0]:.4f}; the shape before them is "
            "kept (more steps for details, and larger images, help)"
        )
        warn(sentence)
        self._advice = (sentence,)
        return outlines

    def _expose(self, vertices: Tensor, faces: Tensor) -> ShapeFit | DetailFit | TextureFit:
        """Make the fit of the current phase; estimate the gains of photos first if colours count."""
        counts = {"shape": self._color_from < 1, "detail": self._detail.light is not None, "texture": True}
        if self._exposure and counts.get(self.phase):
            self.vignetting = 0.0  # the estimate is that of the photos as they were given
            self._gains, self.vignetting = estimate_exposure(self.views, vertices, faces)
        return self._start_phase(vertices, faces)

    def _start_phase(self, vertices: Tensor, faces: Tensor) -> ShapeFit | DetailFit | TextureFit:
        """Make the fit of the current phase."""
        descent, detail = self._descent, self._detail
        if self.phase == "cameras" and self._cameras is not None:
            return coarse_fit(self._given, vertices, faces, self._cameras, self._coarse_steps, descent)
        if self.phase == "shape":
            subdivisions, rate = _SPHERE_PACE if self._start == "sphere" else _PACE
            return ShapeFit(
                self._exposed(),
                vertices,
                faces,
                steps=self._shape.steps,
                subdivisions=subdivisions,
                color_from=self._color_from,
                weights=self._shape.weights,
                rate=rate,
                descent=descent,
                cameras=self._cameras,
            )
        if self.phase == "detail":
            tests = self._test_rows() if detail.light is not None else []
            views = self.views[[row for row in range(len(self._given)) if row not in tests]] if tests else self.views
            steps = MANY_STEPS if detail.steps is None and settles(views, len(views)) else self._detail_steps
            options = {"steps": steps, "seed": descent.seed}
            return DetailFit(views, vertices, faces, weights=detail.weights, light=detail.light, **options)
        options = {"size": self._texture.size, "steps": self._texture.steps, "batch": descent.batch}
        return TextureFit(cut_out(self.views, vertices, faces), vertices, faces, **options)

    def _initial_shape(self) -> tuple[Tensor, Tensor]:
        """Make the vertices and faces with which the current phase starts."""
        if isinstance(self._start, (Mesh, UVMesh)):
            return self._weld(self._start)
        if self._start not in ("hull", "sphere"):
            raise ValueError(f'start: expected "hull", "sphere" or a Mesh, got {self._start!r}')
        if self.phase == "cameras":
            return coarse_hull(self._given)
        if self._start == "hull":
            return carve_levels(self.views) if self._shape.cells is None else carve(self.views, self._shape.cells)
        vertices, faces = icosphere(3, _SPHERE_RADIUS)
        return vertices.to(self._given.masks), faces.to(self._given.masks.device)

    def _weld(self, mesh: Mesh | UVMesh) -> tuple[Tensor, Tensor]:
        """Normalise a mesh and merge equal vertices, because files split vertices at seams of the texture."""
        corners = mesh.vertices.detach()[mesh.faces[(mesh.faces >= 0).all(1)].long()].to(self._given.masks.device)
        vertices, faces = torch.unique((corners.flatten(0, 1) - self._center) / self._scale, dim=0, return_inverse=True)
        faces = faces.view(-1, 3)
        if not bool(self.views.quality((vertices, faces))["iou"].any()):
            raise ValueError("start: expected a mesh in the world of the cameras, got one outside of all silhouettes")
        return vertices, faces


def with_texture(shape: tuple[Tensor, ...]) -> tuple[Tensor, Tensor, Tensor]:
    """Return vertices, faces and textures of a shape; a shape without textures gets the colour of clay."""
    return shape if len(shape) == 3 else (shape[0], shape[1], plain_texture(shape[1]))
