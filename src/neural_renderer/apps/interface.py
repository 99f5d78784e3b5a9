"""Public names of the applications. `neural_renderer` loads this module at the first use of one of them."""

from .many import rendered_views as data
from .pose.find import ObjectPose, find_pose
from .pose.rig_fit import fit_rig, load_keypoints
from .reconstruct.evaluation.picture import Reconstruction, reconstruct
from .view.viewer import Viewer, view

__all__ = [
    "ObjectPose",
    "Reconstruction",
    "Viewer",
    "data",
    "find_pose",
    "fit_rig",
    "load_keypoints",
    "reconstruct",
    "view",
]
