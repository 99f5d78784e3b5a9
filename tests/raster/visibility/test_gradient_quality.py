"""That `gradient="edge"` is the derivative of the image averaged over sub-pixel shifts, measured like the benchmark."""

from __future__ import annotations

import pytest

from benchmarks.gradient_quality import Quality, difference, estimates, scenes, triangle_quality


@pytest.mark.parametrize("side", [4, 16, 64])
@pytest.mark.parametrize("wish", ["shrink", "grow", "shift", "rotate"])
def test_lone_triangle(side, wish):
    """Areas and first moments within 2 %; "rotate" asks for a second moment, of which a pixel of 4 knows no better."""
    found = triangle_quality(side, wish, "edge")
    assert abs(found.size - 1) <= (0.04 if (side, wish) == (4, "rotate") else 0.02), found
    assert found.cosine >= 0.999, found


@pytest.mark.parametrize("title", ["sphere before a plane", "textured mesh"])
def test_scenes(title):
    """Outlines, seams and texture before something else, or nothing: of a dozen coordinates, against differences."""
    scene = scenes()[title]
    order, truth = difference(scene, "vertices", 16, 12)
    samples = estimates(scene, "edge", 64)["vertices"][:, order]
    found = Quality.of(samples, truth.expand(len(samples), -1))
    assert abs(found.size - 1) <= 0.05, found
    assert found.cosine >= 0.99, found
