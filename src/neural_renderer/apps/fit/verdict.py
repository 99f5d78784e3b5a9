"""Verdict on a fit of photographs: good, or doubtful with reasons, the picture to look at, and what mends it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from .photos.pairs import LEAST_AGREEING, MOST_APART
from .photos.witness import Witness

MOST_LACKING, LEAST_CONFIRMED, MOST_THROUGH = 0.015, 0.25, 0.08
LEAST_POINTS, MOST_BESIDE, MOST_LYING, LEAST_EDGES = 0.7, 0.012, 0.03, 0.95
"""Limits of the evidence from photographs, beyond which a mesh is doubtful."""
_FEW_POINTS = 100  # points of all photographs, below which cameras may be wrong though they agree
_RIVALS = 0.5  # least weight, relative to the largest object, of a second one that the user may have meant
_MOST_ELSEWHERE = 0.25  # largest share of the photographs that show the object elsewhere

MASKS, _RESULT = "masks.jpg", "comparison.png"
_TEXTURE = "put a newspaper under it and things around it, take more photographs, or give cameras"
Remedy = Literal["masks", "object", "surface", "cameras"]
"""Argument that helps: masks corrected by hand, the place of the object, an open surface, or known cameras."""


@dataclass(frozen=True)
class Reason:
    """Reason for a doubt."""

    text: str  # what is wrong
    picture: str  # file to look at
    remedy: str = ""  # advice
    arguments: tuple[Remedy, ...] = ()  # arguments that follow the advice


@dataclass(frozen=True)
class Verdict:
    """Verdict on a fit."""

    reasons: tuple[Reason, ...]
    is_of_found: bool  # masks were found, so that figures of outlines say little

    @property
    def word(self) -> Literal["good", "doubtful"]:
        """The verdict in a word."""
        return "doubtful" if self.reasons else "good"


def doubt_shape(witness: Witness) -> list[Reason]:
    """Compare the evidence from photographs with the limits."""
    found = [
        _of_masks(text)
        for is_wrong, text in (
            (
                witness.lacking > MOST_LACKING,
                f"the mesh lacks one part of what stands there, {witness.lacking:.0%} of it: the masks may cut the "
                "object",
            ),
            (
                witness.points < LEAST_POINTS and witness.lacking <= MOST_LACKING,
                f"of the points that photographs share there, the mesh has {witness.points:.0%}: the masks may cut the "
                "object",
            ),
            (
                witness.beside > MOST_BESIDE,
                f"something else stands next to the mesh, {witness.beside:.0%} as large in the photographs: the masks "
                "may cut the object",
            ),
            (
                witness.seen_through > MOST_THROUGH,
                f"photographs see through {witness.seen_through:.0%} of the mesh: the masks may show more than the "
                "object",
            ),
            (
                witness.lying > MOST_LYING,
                f"{witness.lying:.0%} of the mesh lies flat on the ground: the masks may show a piece of it",
            ),
            (
                witness.edges < LEAST_EDGES,
                f"colours change {witness.edges:.1f} times as much at the outlines of the mesh as next to them: the "
                "masks may be too large, too small or shifted",
            ),
        )
        if is_wrong
    ]
    if witness.confirmed < LEAST_CONFIRMED:
        text = f"three photographs confirm {witness.confirmed:.0%} of the mesh: it has little texture, or shines"
        found.append(Reason(text, _RESULT, "show more texture, or correct the masks", ("masks",)))
    return found


def doubt_cameras(agreeing: float, apart: float, points: int, is_smoothed: bool) -> list[Reason]:
    """Doubt cameras that were found, without masks or a mesh.

    Args:
        agreeing: Share of the matched pairs of photographs that agree with the cameras.
        apart: Distance of other cameras that agree with the matches as well, relative to the spread of the cameras.
        points: Number of points that the photographs share.
        is_smoothed: Whether features were found only in smoothed photographs.
    """
    found = [
        text
        for is_wrong, text in (
            (
                agreeing < LEAST_AGREEING,
                f"{1 - agreeing:.0%} of the matched pairs of photographs contradict the cameras that were found: these "
                "may be wrong, as too little can be told apart, or sides of the object look alike; or the object was "
                "moved between photographs, or turned before a room that stood still",
            ),
            (
                apart > MOST_APART,
                f"other cameras, {apart:.0%} of their spread away, agree as well with the photographs: too few matches "
                "hold two groups of photographs together",
            ),
            (points < _FEW_POINTS, f"photographs share only {points} points, so that the cameras may be wrong"),
            (is_smoothed, "too few photographs match as they are: cameras were found only in smoothed copies"),
        )
        if is_wrong
    ]
    return [Reason(text, _RESULT, _TEXTURE, ("cameras",)) for text in found]


def doubt_rivals(second: float) -> list[Reason]:
    """Doubt that an object is the one that is meant, by the weight of a second one."""
    if second < _RIVALS:
        return []
    text = "another object stands there that cameras look at as much"
    return [Reason(text, MASKS, "take it away, or point at the one that is meant", ("object",))]


def doubt_elsewhere(share: float) -> list[Reason]:
    """Doubt cameras by the share of the photographs that are left out as they show the object elsewhere."""
    if share <= _MOST_ELSEWHERE:
        return []
    text = f"{share:.0%} of the photographs show the object elsewhere: it was moved, or the cameras found are wrong"
    return [Reason(text, MASKS, "fit the photographs before and after apart, or give cameras", ("cameras",))]


def doubt_surface(why: str, has_masks: bool) -> Reason:
    """Doubt an open surface that was chosen because no object was found; name a picture to check."""
    text = f"{why}, so that this is an open surface of all that is seen"
    picture = MASKS if has_masks else "preview.png"
    return Reason(text, picture, "ask for the surface, or point at the object", ("surface", "object", "masks"))


def doubt_sentences(sentences: Iterable[str], picture: str = MASKS) -> list[Reason]:
    """Make reasons of sentences that say what is wrong, and perhaps what helps."""
    return [Reason(sentence, picture) for sentence in sentences]


def _of_masks(text: str) -> Reason:
    return Reason(text, MASKS, "correct the masks, or point at the object", ("masks", "object"))
