"""The mean of `gradient="edge"` over sub-pixel shifts is the derivative; measured as in the benchmark."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch.func import jacfwd

from benchmarks.gradient_quality.adapters.ours import Ours, draw
from benchmarks.gradient_quality.quality import Quality
from benchmarks.gradient_quality.scenes import difference, estimates, scenes
from benchmarks.gradient_quality.triangles import triangle_quality


@pytest.mark.parametrize("wish", ["shrink", "grow", "shift", "rotate"])
@pytest.mark.parametrize(
    ("side", "count"), [(16, 36), *(pytest.param(n, 256, marks=pytest.mark.slow) for n in (4, 16, 64))]
)
def test_lone_triangle(side, count, wish):
    """Areas and first moments within 2 %; "rotate" needs second moments, which 4 pixels give within 4 % only."""
    found = triangle_quality(side, wish, Ours("edge"), count)
    assert abs(found.size - 1) <= (0.04 if (side, wish) == (4, "rotate") else 0.02), found
    assert found.cosine >= 0.999, found


class Columns(Ours):
    """The same in forward mode: the product of the picture of each coordinate's derivative with the gradient."""

    def draw(self, picture, pull):
        def image(vertices):
            return draw(replace(picture, vertices=vertices), self.gradient)

        columns = jacfwd(image)(picture.vertices.float())
        to_vertices = torch.einsum("cyx,cyxvk->vk", pull.float(), columns)
        return image(picture.vertices), to_vertices, torch.zeros_like(picture.colors)


@pytest.mark.parametrize("wish", ["shrink", "rotate"])
def test_lone_triangle_in_forward_mode(wish):
    """The mean over sub-pixel shifts has the bounds of `test_lone_triangle`."""
    found = triangle_quality(16, wish, Columns("edge"), 36)
    assert abs(found.size - 1) <= 0.02, found
    assert found.cosine >= 0.999, found


@pytest.mark.parametrize(
    ("title", "name", "shifts"),
    [
        ("light on faces", "vertices", 16),
        ("T-junction", "places", 16),
        *(pytest.param(title, "vertices", 64, marks=pytest.mark.slow) for title in ("occlusion", "smooth texture")),
    ],
)
def test_scenes(title, name, shifts):
    """A dozen coordinates of scenes with outlines, seams and textures, against finite differences."""
    found = quality(title, name, shifts, 8 if shifts == 16 else 16)
    assert abs(found.size - 1) <= 0.05, found
    assert found.cosine >= 0.99, found


@pytest.mark.slow
@pytest.mark.parametrize(("side", "error", "shifts"), [(1, 0.04, 400), (2, 0.02, 144)])
def test_seams_of_small_faces(side, error, shifts):
    """Faces of one or two pixels in random colours: the size within 4 % or 2 %, and what noisy samples leave open."""
    found = quality(f"faces of {side} px, random colours", "places", shifts, 16)
    assert abs(found.size - 1) <= error + 2 * found.interval, found
    assert found.interval <= 0.08, found
    assert found.cosine >= 0.95, found


def quality(title, name, shifts, supersampling):
    scene = scenes()[title]
    order, truth = difference(scene, name, supersampling, 12)
    return Quality.of(estimates(scene, Ours("edge"), shifts)[name][:, order], truth)


def test_intervals_and_noise():
    """Samples 1 and 3 around a truth of 1: size 2, noise 1, and the interval of two samples."""
    found = Quality.of(torch.tensor([[1.0, 0], [3, 0]]), torch.tensor([[1.0, 0]]))
    assert found == Quality(size=2.0, interval=pytest.approx(1.96), cosine=1.0, noise=1.0)


def test_pictures_are_drawn_as_they_say():
    """Colours of corners are linear within a face, and a pixel's centre is half a pixel from its corner."""
    from benchmarks.gradient_quality.picture import Picture

    places = torch.tensor([[-10.0, -10, 2], [40, -10, 2], [-10, 40, 2]]).double()
    picture = Picture(places, torch.tensor([[0, 1, 2]]), places[:, :2].new_zeros(1, 3, 3), 8)
    colors = torch.cat((places[:, :2], torch.zeros(3, 1)), 1)[None] / 10
    image = draw(Picture(picture.vertices, picture.faces, colors.double(), 8), "edge")
    centre = (torch.arange(8.0) + 0.5) / 10
    torch.testing.assert_close(image[0], centre.expand(8, 8), rtol=0, atol=1e-5)
    torch.testing.assert_close(image[1], centre.flip(0)[:, None].expand(8, 8), rtol=0, atol=1e-5)
