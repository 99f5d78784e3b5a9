"""The up direction of a scene, estimated from its cameras."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from .views import Views, view_center

_UPRIGHT = 0.5  # cameras count as upright if the mean of all upward directions is at least this long
_SPREAD = 0.1  # least eigenvalue, relative to the middle one, above which no axis is level for all cameras
_SNAP = 0.985  # a coordinate axis is meant above this cosine, within 10°


def named_up(views: Views) -> str | tuple[float, float, float]:
    """Name the coordinate axis that is up for the cameras, such as "+z"; or return the direction if it is none."""
    x, y, z = up_of_cameras(views).tolist()
    axes = [f"{'-' if value < 0 else '+'}{name}" for name, value in zip("xyz", (x, y, z), strict=True) if value]
    return (x, y, z) if axes[1:] else axes[0]


def up_of_cameras(views: Views) -> Tensor:
    """Estimate the up direction of the cameras: a unit vector [3], snapped to a coordinate axis within 10°.

    Photographers hold cameras level, so that one axis of the image is perpendicular to the vertical in all views: the
    horizontal one, or the other one if the cameras lay on their sides. The sign comes from the images, or else from the
    cameras: more of them look down on an object than up.
    """
    right, up = views.camera.axes[:, 0], views.camera.up
    if float(up.mean(0).norm()) >= min(_UPRIGHT, float(right.mean(0).norm())):
        rough, level = up.mean(0), right
    else:
        rough, level = right.mean(0), up
        above = (views.camera.position - view_center(views)[0]).mean(0)
        rough = rough * torch.sign(rough @ above)
    values, vectors = torch.linalg.eigh(level.t() @ level / len(level))
    if float(values[0]) < _SPREAD * float(values[1]):  # otherwise several directions are level
        axis = vectors[:, 0] * torch.sign(vectors[:, 0] @ rough)
        rough = axis if float(axis @ F.normalize(rough, dim=0)) > _UPRIGHT else rough
    if not float(rough.norm()) > 0:
        return torch.tensor([0.0, 1.0, 0.0])
    found = F.normalize(rough, dim=0).cpu()
    largest = int(found.abs().argmax())
    if float(found[largest].abs()) < _SNAP:
        return found
    return F.one_hot(torch.tensor(largest), 3).float() * found[largest].sign()
