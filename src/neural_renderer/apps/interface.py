"""Public names of the applications. `neural_renderer` loads this module at the first use of one of them."""

from .common.comparators.reinforce import reinforce
from .common.comparators.soft_silhouettes import soft_silhouettes
from .common.geometry.closest_points import closest_points
from .common.geometry.remesh import Remeshed, remesh
from .common.geometry.sample_points import SurfacePoints, sample_points
from .common.geometry.unwrap import unwrap
from .common.pictures.animation import save_animation
from .compare.comparison import Comparison, compare
from .finish.finish import Finished, finish
from .finish.levels import save_levels
from .many import rendered_views as data
from .pose.find import ObjectPose, find_pose
from .pose.rig_fit import fit_rig, load_keypoints
from .reconstruct.evaluation.picture import Reconstruction, reconstruct
from .view.viewer import Viewer, view

__all__ = [
    "Comparison",
    "Finished",
    "ObjectPose",
    "Reconstruction",
    "Remeshed",
    "SurfacePoints",
    "Viewer",
    "closest_points",
    "compare",
    "data",
    "find_pose",
    "finish",
    "fit_rig",
    "load_keypoints",
    "reconstruct",
    "reinforce",
    "remesh",
    "sample_points",
    "save_animation",
    "save_levels",
    "soft_silhouettes",
    "unwrap",
    "view",
]
