"""Old place of `networks.checkpoint`, for one version."""

from ...deprecated import old_module

__getattr__ = old_module(__name__, "neural_renderer.tasks.reconstruction.networks.checkpoint")
