"""Old place of `evaluation.refine`, for one version."""

from ...deprecated import old_module

__getattr__ = old_module(__name__, "neural_renderer.tasks.reconstruction.evaluation.refine", refined="refine_meshes")
