"""Warns of public names that the reference leaves out."""

from typing import Any

from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util import logging

import neural_renderer


def _check(app: Sphinx, env: BuildEnvironment) -> None:
    documented = env.domains["py"].objects  # type: ignore[attr-defined]
    for name in sorted(set(neural_renderer.__all__) - {"__version__"}):
        if f"neural_renderer.{name}" not in documented:
            logging.getLogger(__name__).warning("the reference has no entry for neural_renderer.%s", name)


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("env-check-consistency", _check)
    return {"parallel_read_safe": True}
