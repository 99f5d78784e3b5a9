"""The mean of `gradient="edge"` over sub-pixel shifts is the derivative; measured as in the benchmark."""

from __future__ import annotations

import pytest

from benchmarks.gradient_quality import Quality, difference, estimates, scenes, triangle_quality


@pytest.mark.parametrize("side", [4, 16, 64])
@pytest.mark.parametrize("wish", ["shrink", "grow", "shift", "rotate"])
def test_lone_triangle(side, wish):
    """Areas and first moments within 2 %; "rotate" needs second moments, which 4 pixels give within 4 % only."""
    found = triangle_quality(side, wish, "edge")
    assert abs(found.size - 1) <= (0.04 if (side, wish) == (4, "rotate") else 0.02), found
    assert found.cosine >= 0.999, found


@pytest.mark.parametrize("title", ["sphere before a plane", "textured mesh"])
def test_scenes(title):
    """A dozen coordinates of scenes with outlines, seams and textures, against finite differences."""
    scene = scenes()[title]
    order, truth = difference(scene, "vertices", 16, 12)
    samples = estimates(scene, "edge", 64)["vertices"][:, order]
    found = Quality.of(samples, truth.expand(len(samples), -1))
    assert abs(found.size - 1) <= 0.05, found
    assert found.cosine >= 0.99, found
