"""Old names of the tasks work for one version, with a warning."""

from __future__ import annotations

import pytest

from neural_renderer.tasks import editing, fit


@pytest.mark.parametrize(
    ("module", "old", "new"),
    [(fit, "Weights", "FitWeights"), (fit, "frame", "object_bounds"), (editing, "Views", "RandomViews")],
)
def test_old_names_warn(module, old: str, new: str) -> None:
    with pytest.warns(DeprecationWarning, match=f"{old} is now {new}"):
        assert getattr(module, old) is getattr(module, new)


def test_other_names_are_unknown() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'Nothing'"):
        _ = fit.Nothing
