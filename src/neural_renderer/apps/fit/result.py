"""`FitResult`: a fitted mesh, how well it agrees with the views, and what to do if it does not."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from torch import Tensor

from ...meshes.mesh import Mesh

LEAST_IOU = 0.8
"""Least mean IoU of a match. Fits of photographs reach 0.95, and wrong cameras rarely more than 0.6."""

Verdict = Literal["match", "mismatch"]


@dataclass(frozen=True, eq=False)
class FitResult:
    """Result of a fit: the mesh, its agreement with the views, and what to do.

    `Views.quality` makes the figures: "iou" [N] and, of meshes with colours, "psnr" [N] in decibels.

    Attributes:
        mesh: The mesh, in the world of the cameras.
        agreement: Mean silhouette IoU of the given views, in [0, 1].
        verdict: "match" if ``agreement`` is at least 0.8, else "mismatch": the mesh is not that of the images.
        advice: Sentences that say what went wrong and what to do; empty if all is well.
        fitted: Figures of the given views.
        held_out: Figures of held-out views; None if there are none.
        held_out_located: The same with cameras located on the mesh; None unless cameras were refined.
        held_out_exposed: The same with exposure matched to the mesh; None unless exposure was fitted.

    Example:
        >>> from neural_renderer.apps.fit import MeshFit, Views
        >>> eyes = nr.get_points_from_angles(3.0, 20.0, torch.arange(6) * 60.0)
        >>> views = Views.of(nr.Mesh.icosphere(2), nr.Camera.look_at(eyes, viewing_angle=25), size=32)
        >>> result = MeshFit(views[:5], cells=16, steps=2, texture_steps=2).run(held_out=views[5:])
        >>> result.verdict, result.advice, result.held_out["iou"].shape
        ('match', (), torch.Size([1]))
    """

    mesh: Mesh = field(repr=False)
    agreement: float
    verdict: Verdict
    advice: tuple[str, ...]
    fitted: dict[str, Tensor] = field(repr=False)
    held_out: dict[str, Tensor] | None = field(default=None, repr=False)
    held_out_located: dict[str, Tensor] | None = field(default=None, repr=False)
    held_out_exposed: dict[str, Tensor] | None = field(default=None, repr=False)


def judge(iou: Tensor) -> tuple[float, Verdict, tuple[str, ...]]:
    """Judge a fit by the silhouette IoU [N] of its views: the mean, the verdict, and advice on a mismatch."""
    mean = float(iou.mean())
    if mean >= LEAST_IOU:
        return mean, "match", ()
    sentence = (
        f"the outlines of the result do not match the masks: expected an IoU of at least {LEAST_IOU}, got {mean:.2f}; "
        "the cameras or masks may be wrong, or the fit needs more steps"
    )
    return mean, "mismatch", (sentence,)
