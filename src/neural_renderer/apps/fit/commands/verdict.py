"""Verdict on a fit, for `neural-renderer fit`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ....camera import Camera
from .. import FitResult
from ..options import FitOptions
from ..photos.masks.shape_masks import read_depth
from ..photos.witness import ask
from ..verdict import Reason, Verdict, doubt_rivals, doubt_sentences, doubt_shape


@dataclass(frozen=True)
class Found:
    """Photographs whose masks were found."""

    camera: Camera
    names: Sequence[str]
    doubts: Sequence[str]  # sentences that say what is wrong with the masks


def verdict_of(result: FitResult, options: FitOptions, found: Found | None, colors: str | None) -> Verdict:
    """Judge a fit: by outlines, if masks were given, otherwise also by what masks do not tell.

    Sentences say what is wrong with the colours, if anything is.
    """
    if found is None:
        wrong = result.advice if result.verdict == "mismatch" else ()
        return Verdict(tuple(Reason(sentence, "comparison.png", "") for sentence in wrong), False)
    reasons: list[Reason] = []
    places = (options.output, options.images, *([options.masks.parent] if options.masks else []))
    if known := next(filter(None, (read_depth(place, found.names) for place in places)), None):
        maps, ground, rivals = known
        witness = ask(result.mesh.vertices.cpu().float(), result.mesh.faces.cpu().long(), found.camera, maps, ground)
        reasons += doubt_shape(witness) + ([] if options.object else doubt_rivals(rivals))
    else:
        reasons += doubt_sentences(["nothing but the masks, which were found, tells what the object is"])
    reasons += doubt_sentences(found.doubts)
    if colors:
        reasons += doubt_sentences([colors], "comparison.png")
    if result.verdict == "mismatch":  # further advice is about files of cameras, and there is none
        reasons += doubt_sentences(result.advice[:1])
    return Verdict(tuple(reasons), True)
