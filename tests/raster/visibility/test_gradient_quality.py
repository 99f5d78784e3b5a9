"""The mean of `gradient="edge"` over sub-pixel shifts is the derivative; measured as in the benchmark."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch.func import jacfwd

import neural_renderer as nr
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


@pytest.mark.parametrize("noisy", [False, True])
def test_corners_move_each_by_itself(noisy):
    """A silhouette of 80 faces and weights of one pixel each, constant or noise, against integrals along its outline.

    An estimate is the derivative of pixels averaged over shifts along the motion; the mean over shifts averages again.
    So weights count as if interpolated linearly along the motion. Averaged once, noise has a larger derivative.
    """
    size, side = 24, 24
    vertices, faces = nr.icosphere(1)
    turn = torch.linalg.matrix_exp(torch.tensor([[0.0, -0.6, 0.4], [0.6, 0, -0.7], [-0.4, 0.7, 0]]).double())
    vertices = vertices.double() @ turn.T * torch.tensor([8.0, 8, 1]) + torch.tensor([12.1, 11.8, 3])
    weight = torch.ones(size, size, dtype=torch.float64)
    if noisy:
        weight.normal_(generator=torch.Generator().manual_seed(0))
    cells = torch.arange(side, dtype=torch.float64)
    moved = vertices.repeat(side * side, 1, 1)
    moved[..., :2] += ((torch.cartesian_prod(cells, cells) + 0.5) / side - 0.5)[:, None]
    moved[..., :2] = moved[..., :2] * 2 / size - 1
    moved = moved.float().requires_grad_()
    options = {"outputs": "alpha", "anti_aliasing": False, "perspective": False, "gradient": "edge"}
    (nr.rasterize_images(moved[:, faces], size, **options).alpha * weight.float()).sum().backward()
    samples = moved.grad[..., :2].flatten(1).double() * 2 / size
    twice, once = (outline_integral(vertices[:, :2], faces, weight, again).view(1, -1) for again in (True, False))
    found = Quality.of(samples, twice)
    assert abs(found.size - 1) <= found.interval, found
    assert found.interval <= 0.03 and found.cosine >= 0.999, found
    assert (Quality.of(samples, once).size < 0.9) == noisy


def outline_integral(places, faces, weight, again):
    """Differentiate the integral of weights [size, size] over a convex silhouette by its corners [V, 2], in pixels.

    ``again``: for the motion along an axis, the weights are averaged over a pixel along it, that is, interpolated.
    """
    a, b = places[faces[:, 1]] - places[faces[:, 0]], places[faces[:, 2]] - places[faces[:, 0]]
    front = faces[a[:, 0] * b[:, 1] > a[:, 1] * b[:, 0]]
    edges = torch.cat((front[:, [0, 1]], front[:, [1, 2]], front[:, [2, 0]])).tolist()
    p, q = torch.tensor([edge for edge in edges if edge[::-1] not in edges]).T
    share = (torch.arange(2000.0).double() + 0.5)[:, None, None] / 2000
    points = places[p] + share * (places[q] - places[p])  # [N, E, 2]
    along = places[q] - places[p]
    normal = torch.stack((along[:, 1], -along[:, 0]), 1)  # outward, of the edge's length
    result = torch.zeros_like(places)
    for axis in range(2):
        step = torch.tensor([0.5, 0] if axis == 0 else [0, 0.5]).double()
        part = (points - step)[..., axis] % 1
        pull = weight_at(weight, points)
        if again:
            pull = part * weight_at(weight, points + step) + (1 - part) * weight_at(weight, points - step)
        change = normal[:, axis] * pull
        result[:, axis].index_add_(0, p, ((1 - share[..., 0]) * change).mean(0))
        result[:, axis].index_add_(0, q, (share[..., 0] * change).mean(0))
    return result


def weight_at(weight, points):
    """Read the weights of the pixels that contain the points [..., 2], from the bottom left."""
    column, row = points.floor().long().unbind(-1)
    return weight.flip(0)[row, column]


def test_a_sliver_moves_no_color():
    """A surface of three colours, the last on a sliver of 0.004 pixels at the outline, keeps its areas if it moves."""
    places = [[5.2, 5.1], [12.3, 4.9], [12.1, 19.2], [5.4, 18.8], [14.5, 5.3], [14.2, 19.1], [14.354, 12.2]]
    faces = torch.tensor([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2], [4, 6, 5]])
    colors = torch.tensor([0.2, 0.2, 0.9, 0.9, 0.5]).view(1, 5, 1, 1, 1, 1).expand(-1, -1, -1, -1, -1, 3)
    shifts = (torch.cartesian_prod(torch.arange(20.0), torch.arange(20.0)) + 0.5) / 20
    moved = (torch.tensor(places) + shifts[:, None]) / 12 - 1
    moved = torch.nn.functional.pad(moved, (0, 1), value=2.0).requires_grad_()
    options = {"outputs": "rgb", "anti_aliasing": False, "gradient": "edge"}
    nr.rasterize_images(moved[:, faces], 24, textures=colors, **options).rgb[:, 0].sum().backward()
    samples = moved.grad[..., 0].sum(1) / 12
    assert samples.std() / 20 < 0.02
    assert samples.mean().abs() < 3 * samples.std() / 20, samples.mean()


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
