"""Stand-ins: visible faces behind the outline of a face that all pixel centres miss; see `outlines`."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.launch import array, launch
from ..warp.memory import empty
from ..warp.point import fill
from .neighbors import neighbors
from .outlines import LONGEST

# Compiled with the kernels of `neighbors`, which are needed before: a module of its own would take longer.
_MODULE = wp.get_module(neighbors.__module__)


def steps_to_visible(visible: Tensor, adjacent: Tensor) -> Tensor:
    """Count the steps from each face, over adjacent faces, to the next one that is visible. For the CPU.

    Args:
        visible: 1 for each visible face, [B, F + 1] int32, as from `visible_faces`.
        adjacent: [B, F, 3] int32, as from `neighbors`.

    Returns:
        [B, F] int32: 0 for visible faces; LONGEST + 1 if there are more than LONGEST steps.
    """
    batch, count = adjacent.shape[:2]
    room = empty((2, batch, count), adjacent.device, torch.int32)
    launch(_count_steps, batch, [array(visible), array(adjacent), array(room)], adjacent.device)
    return room[0]


# Faces that are hidden improve their steps by those of adjacent faces, until none does.
_COUNT = """
    const wp::int64 faces = adjacent.shape[1], own = b * faces;
    const int *shown = visible.data + b * (faces + 1), *next = adjacent.data + own * 3;
    int *steps = room.data + own, *hidden = steps + room.shape[1] * faces, count = 0;
    for (int f = 0; f < faces; ++f) {
        steps[f] = shown[f] ? 0 : LONGEST + 1;
        const bool lonely = (next[3 * f] < 0) & (next[3 * f + 1] < 0) & (next[3 * f + 2] < 0);
        hidden[count] = f, count += !(shown[f] | lonely);
    }
    bool improves = true;
    for (int n = 0; n < LONGEST && improves; ++n) {
        improves = false;
        for (int i = 0; i < count; ++i) {
            const int f = hidden[i];
            int least = steps[f];
            for (int k = 0; k < 3; ++k) {
                const int g = next[3 * f + k];
                const int through = g < 0 ? LONGEST + 1 : steps[g] + 1;
                least = through < least ? through : least;
            }
            improves |= least < steps[f], steps[f] = least;
        }
    }
"""


@wp.func_native(fill(_COUNT, LONGEST=str(LONGEST)))
def count_steps(visible: wp.array2d(dtype=int), adjacent: wp.array3d(dtype=int), room: wp.array3d(dtype=int), b: int):
    """Count the steps of the faces of image b into the first half of ``room``; the second is a list of faces."""
    ...


@wp.kernel(module=_MODULE)
def _count_steps(
    first: int, visible: wp.array2d(dtype=int), adjacent: wp.array3d(dtype=int), room: wp.array3d(dtype=int)
):
    """Count the steps of all faces of an image."""
    count_steps(visible, adjacent, room, first + wp.tid())
