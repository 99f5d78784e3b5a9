"""The page for users of SoftRas: each row shows what SoftRas shows.

Formulas are those of its paper (Liu et al., "Soft Rasterizer", 2019) and of its functions, written here in float64 and
by brute force.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, normalize, relu

import neural_renderer as nr
from tests.coming_from.pages import Page, needs_pages, same_but_at_edges
from tests.rounding import EPS, rounding

pytestmark = needs_pages
PAGE = Page("from_softras.md")
AT_EDGES = 0.01


def axes(z: Tensor) -> Tensor:
    """Rows of the rotation of `look` and `look_at`: x = up × z, which mirrors, y = z × x."""
    z = normalize(z.double(), dim=-1)
    x = normalize(torch.linalg.cross(torch.tensor([0.0, 1.0, 0.0]).double(), z), dim=-1)
    return torch.stack((x, torch.linalg.cross(z, x), z))


def look_at(vertices: Tensor, eye: Any) -> Tensor:
    eye = torch.tensor(eye).double()
    return (vertices.double() - eye) @ axes(-eye).T


def perspective(points: Tensor, angle: float = 30.0) -> Tensor:
    """Screen coordinates in [−1, 1], y up, and the depth."""
    width = math.tan(math.radians(angle))
    return torch.cat((points[..., :2] / points[..., 2:] / width, points[..., 2:]), -1)


def centres(size: int) -> Tensor:
    """Pixel centres, [size, size, 2], row 0 at the top."""
    along = (2 * torch.arange(size).double() + 1 - size) / size
    return torch.stack((along.expand(size, -1), -along[:, None].expand(-1, size)), -1)


class Scene:
    """What SoftRas draws of the page's mesh with ``dist_func="hard"``, pixel by pixel."""

    def __init__(self, given: dict[str, Any], size: int = 64) -> None:
        self.vertices, self.faces = given["vertices"].double(), given["faces"].long()
        self.corners = perspective(look_at(self.vertices, given["eye"]))[self.faces]
        self.face, nearest = torch.full((size, size), -1), torch.full((size, size), torch.inf).double()
        self.weights = torch.zeros(size, size, 3).double()
        pixels = torch.cat((centres(size), torch.ones(size, size, 1)), -1)
        for number, corners in enumerate(self.corners):
            flat = pixels @ torch.linalg.inv(torch.cat((corners[:, :2], torch.ones(3, 1)), 1))
            depth = 1 / (flat / corners[:, 2]).sum(-1)
            nearer = (flat >= 0).all(-1) & (depth < nearest)
            # The weights of colours are those on the screen, not in space.
            self.face[nearer], nearest[nearer], self.weights[nearer] = number, depth[nearer], flat[nearer]
        self.alpha = (self.face >= 0).double()

    def of_faces(self, values: Tensor) -> Tensor:
        """Show colours of faces [F, 3], [3, H, W]."""
        return values.double()[self.face].movedim(-1, 0) * self.alpha

    def light(self) -> Tensor:
        """Light 0.5 + 0.5 max(n · (0, 1, 0), 0) on the fronts of faces, [F, 3]."""
        a, b, c = self.vertices[self.faces].unbind(1)
        normals = normalize(torch.linalg.cross(b - a, c - a), dim=-1)
        return (0.5 + 0.5 * relu(normals[:, 1:2])).expand(-1, 3)


@pytest.fixture
def given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    monkeypatch.chdir(tmp_path)
    names = PAGE.names()
    names["eye"] = nr.get_points_from_angles(names["distance"], names["elevation"], names["azimuth"])
    names["camera"] = nr.Camera.look_at(names["eye"], viewing_angle=30, mirrored=True)
    return names


def test_every_row_has_a_check() -> None:
    assert not PAGE.missing()


@pytest.mark.parametrize("left", PAGE.rows)
def test_row(left: str, given: dict[str, Any]) -> None:
    PAGE.check(left, given)


@PAGE.row('`sr.Mesh.from_obj("a.obj", load_texture')
def _(given, values):
    lines = [line.split() for line in Path("a.obj").read_text().splitlines()]
    expected = torch.tensor([[float(n) for n in line[1:4]] for line in lines if line and line[0] == "v"])
    for mesh in values:
        assert torch.equal(mesh.vertices, expected)


@PAGE.row('`sr.Mesh.from_obj("a.obj", normalization')
def _(given, values):
    # The box's longest side is from −1 to 1, and its middle at the origin.
    vertices = given["vertices"].double()
    vertices = 2 * (vertices - vertices.amin(0)) / (vertices - vertices.amin(0)).max()
    torch.testing.assert_close(values[0].vertices.double(), vertices - vertices.amax(0) / 2, **rounding(16))


@PAGE.row("`sr.Mesh(vertices, faces)`")
def _(given, values):
    scene = Scene(given)
    for mesh in values[:2]:
        alpha = nr.render(mesh, given["camera"], 64, outputs="alpha", anti_aliasing=False).alpha
        same_but_at_edges(alpha[0], scene.alpha, 0.0, AT_EDGES)
    rgb = nr.render(values[0], given["camera"], 64, light=None, anti_aliasing=False).rgb
    same_but_at_edges(rgb[0], scene.of_faces(torch.ones(len(scene.faces), 3)), 1e-6, AT_EDGES)


@PAGE.row("`sr.Mesh(vertices, faces, colors,")
def _(given, values):
    # SoftRas interpolates on the screen; faces of a fine mesh differ little from those in space.
    scene = Scene(given)
    corners = given["colors"].double()[scene.faces][scene.face]
    expected = ((scene.weights[..., None] * corners).sum(-2) * scene.alpha[..., None]).movedim(-1, 0)
    rgb = nr.render(values[0], given["camera"], 64, light=None, anti_aliasing=False).rgb
    same_but_at_edges(rgb[0], expected, 0.06, AT_EDGES)


@PAGE.row("`sr.Mesh(vertices, faces, face_colors[")
def _(given, values):
    rgb = nr.render(values[0], given["camera"], 64, light=None, anti_aliasing=False).rgb
    same_but_at_edges(rgb[0], Scene(given).of_faces(given["face_colors"]), 1e-6, AT_EDGES)


@PAGE.row("`mesh.save_obj(")
def _(given, values):
    assert torch.equal(nr.Mesh.load("b.obj").vertices, given["vertices"])


@PAGE.row("`mesh.voxelize(32)`")
def _(given, values):
    assert not hasattr(nr.Mesh, "voxelize")


@PAGE.row("`mesh.reset_()`")
def _(given, values):
    before = {name: part.clone() for name, part in given["mesh"]._buffers.items() if part is not None}
    nr.render(given["mesh"], given["camera"], 64, light=nr.Light())
    for name, part in before.items():
        assert torch.equal(getattr(given["mesh"], name), part)


@PAGE.row("`transform.set_eyes_from_angles(")
def _(given, values):
    elevation, azimuth = math.radians(given["elevation"]), math.radians(given["azimuth"])
    expected = (math.cos(elevation) * math.sin(azimuth), math.sin(elevation), -math.cos(elevation) * math.cos(azimuth))
    assert given["eye"] == pytest.approx([given["distance"] * part for part in expected], rel=8 * EPS)


def on_screen(found: Tensor, expected: Tensor) -> None:
    torch.testing.assert_close(found[0].double(), expected, **rounding(64, 4))


@PAGE.row("`sr.LookAt(viewing_angle=30")
def _(given, values):
    on_screen(given["camera"](given["vertices"]), perspective(look_at(given["vertices"], given["eye"])))


@PAGE.row("`sr.LookAt(perspective=False")
def _(given, values):
    points = look_at(given["vertices"], given["eye"])
    on_screen(values[0](given["vertices"]), points * torch.tensor([0.8, 0.8, 1.0]))


@PAGE.row("`sr.Look(camera_direction")
def _(given, values):
    points = (given["vertices"].double() - torch.tensor([0, 0, -3.0])) @ axes(torch.tensor([0, 0, 1.0])).T
    on_screen(values[0](given["vertices"]), perspective(points))


@PAGE.row("`sr.Projection(")
def _(given, values):
    points = given["vertices"].double() @ given["R"].double().T + given["t"].double()
    pixels = points @ given["K"].double().T
    screen = 2 * (pixels[:, :2] / pixels[:, 2:] - 64 / 2) / 64
    # y grows down in K's pixels, and up on the screen of SoftRas: it shows the picture upside down.
    on_screen(values[0](given["vertices"]), torch.cat((screen * torch.tensor([1.0, -1.0]), points[:, 2:]), 1))


@PAGE.row("`sr.Lighting()`")
def _(given, values):
    scene = Scene(given)
    rgb = nr.render(given["mesh"], given["camera"], 64, light=values[0], anti_aliasing=False).rgb
    same_but_at_edges(rgb[0], scene.of_faces(scene.light()), 1e-5, AT_EDGES)


@PAGE.row('`sr.Lighting("vertex")`')
def _(given, values):
    scene = Scene(given, 128)
    a, b, c = scene.vertices[scene.faces].unbind(1)
    sums = torch.zeros_like(scene.vertices)
    for corner in range(3):
        sums.index_add_(0, scene.faces[:, corner], torch.linalg.cross(b - a, c - a))
    light = 0.5 + 0.5 * relu(normalize(sums, dim=-1)[:, 1])
    shown = (scene.weights * light[scene.faces][scene.face]).sum(-1) * scene.alpha
    # On pixels the normal is normalised once more: it differs by the cosine of half the angle across a face.
    same_but_at_edges(values[0].rgb[0], avg_pool2d(shown[None], 2).expand(3, -1, -1), 0.03, AT_EDGES)


@PAGE.row('`sr.SoftRenderer(aggr_func_rgb="hard")`')
def _(given, values):
    scene = Scene(given)
    same_but_at_edges(values[0].rgb[0], scene.of_faces(scene.light()), 1e-5, AT_EDGES)


@PAGE.row('`sr.SoftRenderer(dist_func="hard"')
def _(given, values):
    same_but_at_edges(values[0][0], Scene(given).alpha, 0.0, AT_EDGES)


def blurred(corners: Tensor, size: int, sigma: float) -> Tensor:
    """Equations 1 and 2 of the paper: 1 − Π (1 − sigmoid(± d² / σ)) of the distances d to the outlines of faces."""
    uncovered = torch.ones(size, size).double()
    for triangle in corners[..., :2]:
        reach = math.sqrt(sigma * math.log(1e4))
        left, top = ((torch.stack((triangle.amin(0)[0], -triangle.amax(0)[1])) - reach + 1) * size / 2).long().tolist()
        right, bottom = ((torch.stack((triangle.amax(0)[0], -triangle.amin(0)[1])) + reach + 1) * size / 2).long() + 1
        box = slice(max(top, 0), max(int(bottom), 0)), slice(max(left, 0), max(int(right), 0))
        pixels = centres(size)[box]
        ends = triangle.roll(-1, 0)
        along = ends - triangle
        arms = pixels[..., None, :] - triangle
        share = ((arms * along).sum(-1) / along.square().sum(-1)).clamp(0, 1)
        square = (arms - share[..., None] * along).square().sum(-1).amin(-1)
        side = along[:, 0] * arms[..., 1] - along[:, 1] * arms[..., 0]
        inside = (side > 0).all(-1) | (side < 0).all(-1)
        cover = torch.sigmoid(torch.where(inside, square, -square) / sigma)
        uncovered[box] *= 1 - torch.where(cover > 1e-4, cover, 0.0)  # dist_eps
    return 1 - uncovered


@PAGE.row("`sr.SoftRenderer(sigma_val=1e-4)`")
def _(given, values):
    # The blur vanishes with sigma: then the images are equal but for pixels whose centre is on an edge.
    scene = Scene(given, 128)
    sharp = blurred(scene.corners, 128, 1e-10)
    same_but_at_edges(values[0], avg_pool2d(sharp[None], 2), 0.01, AT_EDGES)


@PAGE.row("the same blur")
def _(given, values):
    # Faces whose share is just below 1e-4 count in one and not in the other, up to a few on a pixel.
    same_but_at_edges(values[0][0], blurred(Scene(given).corners, 64, 1e-4), 5e-4, 0.0)


@PAGE.row("`sr.SoftRenderer(anti_aliasing=True)`")
def _(given, values):
    same_but_at_edges(values[0].alpha, avg_pool2d(Scene(given, 128).alpha[None], 2), 0.0, AT_EDGES)


@PAGE.row("`sr.SoftRenderer(background_color")
def _(given, values):
    scene = Scene(given)
    alpha = nr.render(given["mesh"], given["camera"], 64, outputs="alpha").alpha[0]
    assert (values[0].rgb[0, :, alpha == 0] == 1).all() and (scene.alpha[alpha == 0] == 0).all()


@PAGE.row("`sr.LaplacianLoss(")
def _(given, values):
    vertices, faces = given["vertices"].double(), given["faces"].long()
    matrix = torch.zeros(len(vertices), len(vertices)).double()
    for a, b in ((0, 1), (1, 2), (2, 0)):
        matrix[faces[:, a], faces[:, b]] = matrix[faces[:, b], faces[:, a]] = -1
    matrix -= torch.diag(matrix.sum(1))
    expected = (matrix / matrix.diag()[:, None] @ vertices).square().sum()
    torch.testing.assert_close(values[0].double(), expected, **rounding(64, 10))


def flatten_loss(vertices: Tensor, faces: Tensor, all_edges: bool) -> Tensor:
    """Sum (cos + 1)² over edges; cos is of the angle between the parts of two faces that are normal to the edge."""
    opposite: dict[tuple[int, int], list[int]] = {}
    listed = set()
    for face in faces.tolist():
        for k in range(3):
            edge = (min(face[k], face[(k + 1) % 3]), max(face[k], face[(k + 1) % 3]))
            opposite.setdefault(edge, []).append(face[(k + 2) % 3])
            if k < 2:  # SoftRas lists the edges from corner 0 to 1 and from 1 to 2
                listed.add(edge)
    kept = [(*edge, *ends) for edge, ends in opposite.items() if len(ends) == 2 and (all_edges or edge in listed)]
    v0, v1, v2, v3 = vertices[torch.tensor(kept)].unbind(1)
    edge = normalize(v1 - v0, dim=-1)
    first, second = (end - v0 - ((end - v0) * edge).sum(-1, keepdim=True) * edge for end in (v2, v3))
    return (torch.cosine_similarity(first, second, dim=-1) + 1).square().sum()


@PAGE.row("`sr.FlattenLoss(")
def _(given, values):
    rough = given["vertices"] * (1 + 0.2 * given["colors"][:, :1])
    found = nr.losses.smoothness(rough.double(), given["faces"])
    torch.testing.assert_close(found, flatten_loss(rough.double(), given["faces"], True), rtol=1e-9, atol=0)
    # The page says that SoftRas has fewer edges.
    fewer = flatten_loss(rough.double(), given["faces"], False)
    assert 0.5 * found < fewer <= found
    expected = flatten_loss(given["vertices"].double(), given["faces"], True)
    torch.testing.assert_close(values[0].double(), expected, rtol=1e-2, atol=0)  # nearly flat: cos + 1 cancels


@PAGE.row("`neg_iou_loss(")
def _(given, values):
    predicted, target = torch.rand(2, 64, 64), torch.rand(2, 64, 64)
    both = (predicted * target).sum((1, 2))
    expected = 1 - (both / ((predicted + target - predicted * target).sum((1, 2)) + 1e-6)).mean()
    torch.testing.assert_close(nr.losses.soft_iou_loss(predicted, target), expected)
    assert 0 < values[0] < 1


def test_the_program_has_the_loss_of_softras(given: dict[str, Any]) -> None:
    names = given | {
        "deformed": (0.5 * given["vertices"]).requires_grad_(),
        "distances": torch.full((2,), 2.7),
        "elevations": torch.full((2,), 30.0),
        "azimuths": torch.tensor([45.0, 90.0]),
        "target": torch.rand(2, 64, 64),
    }
    exec(PAGE.programs[2], names)
    alpha = []
    for azimuth in (45.0, 90.0):
        eye = nr.get_points_from_angles(2.7, 30.0, azimuth)
        corners = perspective(look_at(0.5 * given["vertices"], eye), 15.0)[given["faces"].long()]
        alpha.append(avg_pool2d(blurred(corners, 128, 1e-10)[None], 2)[0])
    same_but_at_edges(names["alpha"].detach(), torch.stack(alpha), 0.01, AT_EDGES)
    names["loss"].backward()
    assert names["deformed"].grad.abs().max() > 0
