"""Labels of contact sheets."""

from __future__ import annotations

import torch

from neural_renderer.apps.common.pictures.sheet import sheet


def test_letters_that_the_font_lacks() -> None:
    """They become those that it has, and no boxes."""
    [asked, drawn] = (sheet([[torch.ones(3, 160, 160)]], [label]) for label in ("Ünï 猫", "Uni ?"))
    assert torch.equal(asked, drawn)
