"""Verdict on a fit of photographs: good, or doubtful with reasons, the picture to look at, and what mends it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any, Literal

from .photos.witness import Witness

LEAST_EXPLAINED, LEAST_CONFIRMED, MOST_THROUGH = 0.8, 0.2, 0.08
"""Limits of what photographs say of a mesh, beyond which it is doubtful."""
_RIVALS = 0.5  # weight of a second object relative to the first, from which it may be the one that is meant

_MASKS = "masks.jpg"
_MEND = "correct the masks and give --masks, or point at the object with --object X Y"


@dataclass(frozen=True)
class Reason:
    """Reason for a doubt."""

    text: str  # what is wrong
    picture: str  # file to look at
    remedy: str  # what mends it


@dataclass(frozen=True)
class Verdict:
    """Verdict on a fit."""

    reasons: tuple[Reason, ...]
    is_of_found: bool  # masks were found, so that figures of outlines say little

    @property
    def word(self) -> Literal["good", "doubtful"]:
        """The verdict in a word."""
        return "doubtful" if self.reasons else "good"

    def lines(self) -> list[str]:
        """Say the verdict and its reasons, a line each."""
        ends = ("; ".join(filter(None, (it.text, f"look at {it.picture}", it.remedy))) for it in self.reasons)
        return [f"verdict: {self.word}", *ends]

    def report(self) -> dict[str, Any]:
        """Make what a report has of the verdict."""
        return {"verdict": self.word, "reasons": [asdict(reason) for reason in self.reasons]}


def doubt_shape(witness: Witness) -> list[Reason]:
    """Compare what photographs say of a mesh with the limits."""
    found = []
    if witness.explained < LEAST_EXPLAINED:
        text = f"of what stands there, the mesh has {witness.explained:.0%}: the masks may cut the object"
        found.append(Reason(text, _MASKS, _MEND))
    if witness.seen_through > MOST_THROUGH:
        text = (
            f"photographs see through {witness.seen_through:.0%} of the mesh: the masks may show more than the object"
        )
        found.append(Reason(text, _MASKS, _MEND))
    if witness.confirmed < LEAST_CONFIRMED:
        text = f"three photographs confirm {witness.confirmed:.0%} of the mesh: it has little texture, or shines"
        found.append(Reason(text, "comparison.png", "show more texture, or correct the masks and give --masks"))
    return found


def doubt_rivals(second: float) -> list[Reason]:
    """Doubt that an object is the one that is meant, by the weight of a second one."""
    if second < _RIVALS:
        return []
    text = "another object stands there that cameras look at as much"
    return [Reason(text, _MASKS, "take it away, or point at the one that is meant with --object X Y")]


def doubt_sentences(sentences: Iterable[str], picture: str = _MASKS) -> list[Reason]:
    """Make reasons of sentences that say what is wrong, and after a colon or a stop what helps."""
    return [Reason(sentence, picture, _MEND) for sentence in sentences]
