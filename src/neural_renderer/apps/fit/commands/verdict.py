"""Verdict on a fit, for `neural-renderer fit`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .. import FitResult, Views
from ..options import FitOptions
from ..photos.geometry.depth import DepthMaps
from ..photos.masks.shape_masks import read_depth
from ..photos.witness import ask
from ..verdict import (
    MASKS,
    Reason,
    Verdict,
    doubt_cameras,
    doubt_elsewhere,
    doubt_rivals,
    doubt_sentences,
    doubt_shape,
    doubt_surface,
)
from .cameras import ELSEWHERE, EVIDENCE, NO_OBJECT

_OPTIONS = {
    "masks": "--masks FOLDER",
    "object": "--object X Y",
    "surface": "--surface",
    "cameras": "a folder with cameras as IMAGES",
}


@dataclass(frozen=True)
class Found:
    """Photographs whose masks were found."""

    views: Views  # all of them, with whole photographs, those that were held out, too
    names: Sequence[str]
    points: Tensor | None  # [P, 3], points of structure from motion
    depth: tuple[DepthMaps, np.ndarray | None, float] | None  # as `read_depth` returns it
    doubts: Sequence[str]  # sentences that say what is wrong with the masks


def known_depth(options: FitOptions, names: Sequence[str]) -> tuple[DepthMaps, np.ndarray | None, float] | None:
    """Read the depth of photographs with these names, where an earlier search for masks wrote it."""
    places = (options.output, options.images, *([options.masks.parent] if options.masks else []))
    return next(filter(None, (read_depth(place, names) for place in places)), None)


def verdict_of(
    result: FitResult, options: FitOptions, found: Found | None, colors: str | None, facts: dict[str, Any]
) -> Verdict:
    """Judge a fit: by outlines, if masks were given, otherwise also by evidence outside masks.

    A sentence says what is wrong with the colours, if that is so. Facts about photographs say why there is a surface in
    place of an object, and how well the cameras that were found agree with them.
    """
    cameras = doubt_cameras(*(facts[key] for key in EVIDENCE)) if EVIDENCE[0] in facts else []
    cameras += doubt_elsewhere(facts.get(ELSEWHERE, 0.0))
    no_object = facts.get(NO_OBJECT)
    if found is None:
        wrong = result.advice if result.verdict == "mismatch" else ()
        surface = [] if no_object is None else [doubt_surface(no_object, (options.output / MASKS).is_file())]
        return Verdict((*cameras, *surface, *doubt_sentences(wrong, "comparison.png")), False)
    reasons = list(cameras)
    if found.depth is not None and found.views.scenes is not None:
        maps, ground, rivals = found.depth
        mesh, camera = result.mesh, found.views.camera.to("cpu")
        points = torch.zeros(0, 3) if found.points is None else found.points.cpu()
        witness = ask(
            mesh.vertices.cpu().float(), mesh.faces.cpu().long(), camera, maps, ground, found.views.scenes, points
        )
        reasons += doubt_shape(witness) + ([] if options.object else doubt_rivals(rivals))
    else:
        reasons += doubt_sentences(["only the masks, which were found automatically, separate the object"])
    reasons += doubt_sentences(found.doubts)
    if colors:
        reasons += doubt_sentences([colors], "comparison.png")
    if result.verdict == "mismatch":  # further advice is about files of cameras, and there is none
        reasons += doubt_sentences(result.advice[:1])
    return Verdict(tuple(reasons), True)


def verdict_lines(verdict: Verdict) -> list[str]:
    """Say a verdict and its reasons, a line each, with the options that help."""
    ends = ("; ".join(filter(None, (it.text, f"look at {it.picture}", _remedy(it)))) for it in verdict.reasons)
    return [f"verdict: {verdict.word}", *ends]


def verdict_report(verdict: Verdict) -> dict[str, Any]:
    """Make the entries of a report for a verdict."""
    rows = [{"text": it.text, "picture": it.picture, "remedy": _remedy(it)} for it in verdict.reasons]
    return {"verdict": verdict.word, "reasons": rows}


def _remedy(reason: Reason) -> str:
    """Describe how to correct the cause, with the options for it."""
    options = ", ".join(_OPTIONS[name] for name in reason.arguments)
    return f"{reason.remedy} ({options})" if options else reason.remedy
