"""The guides for users of other packages: every row of their tables runs, and shows what the other package would."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import neural_renderer as nr
from tests.rounding import rounding

GUIDES = Path(__file__).resolve().parents[1] / "docs" / "guides"
CODE = re.compile(r"`([^`]+)`")

pytestmark = pytest.mark.skipif(not GUIDES.is_dir(), reason="the documentation is not here")


def rows(page: str) -> list[list[str]]:
    """The cells of the page's tables, without their heads."""
    lines = (GUIDES / page).read_text(encoding="utf-8").splitlines()
    cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines if line.startswith("|")]
    return [row for row in cells if not set(row[0]) <= set("-|") and row[1] not in ("here", "modern")]


def names(page: str) -> dict[str, Any]:
    """The names that the page's first program gives to the tables."""
    program = re.search(r"```python\n(.*?)```", (GUIDES / page).read_text(encoding="utf-8"), re.DOTALL)
    given: dict[str, Any] = {}
    exec(program[1], given)
    return given


def run(cell: str, given: dict[str, Any]) -> list[Any]:
    """Run the pieces of code of a cell that are more than a name; return the values, None for an assignment."""
    values = []
    for code in CODE.findall(cell):
        try:
            values.append(eval(code, given))
        except SyntaxError:
            exec(code, given)
            values.append(None)
    return values


MODERN_NOTES = {"rgb", "alpha", "depth", "render", "fragments", "fov", "[B, H, W]", "[F, 3, C]", "[V, C]"}


@pytest.mark.parametrize("page", ["from_neural_renderer.md", "from_nvdiffrast.md", "from_pytorch3d.md"])
def test_right_columns_run(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    given = names(page)
    count = 0
    for row in rows(page):
        pieces = [code for code in CODE.findall(row[1]) if code not in MODERN_NOTES]
        for code in pieces:
            assert "…" not in code, f"{page}: expected code that runs, got {code}"
            try:
                run(f"`{code}`", given)
            except Exception as error:
                raise AssertionError(f"{page}: expected code that runs, got {code}: {error}") from error
        count += bool(pieces)
    assert count > 10


def test_both_columns_of_the_first_packages_show_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    given = names("from_neural_renderer.md")
    compared = 0
    for row in rows("from_neural_renderer.md"):
        with torch.no_grad():
            left, right = run(row[0], given), run(row[1], given)
        if "renderer(" not in row[0]:
            continue
        if isinstance(right[0], nr.Images):
            old = dict(zip(("rgb", "depth", "alpha"), left[0], strict=True))
            pairs = [(old[name], getattr(right[0], name)) for name in old]
        else:
            pairs = [(left[0], right[0])]
        for old_image, image in pairs:
            # Depth is up to 100 at outlines.
            torch.testing.assert_close(old_image, image, **rounding(64, 100))
            compared += 1
    assert compared == 5


class Nvdiffrast:
    """The primitives of nvdiffrast, from their documentation, in float64 and by brute force; row 0 at the bottom."""

    @staticmethod
    def rasterize(pos: np.ndarray, tri: np.ndarray, height: int, width: int) -> np.ndarray:
        rast = np.zeros((height, width, 4))
        nearest = np.full((height, width), np.inf)
        x, y = np.meshgrid((np.arange(width) + 0.5) / width * 2 - 1, (np.arange(height) + 0.5) / height * 2 - 1)
        for number, triangle in enumerate(tri):
            p = pos[triangle]
            planes = np.linalg.inv(p[:, [0, 1, 3]])  # (x, y, 1) / w → weights / w
            share = np.stack((x, y, np.ones_like(x)), -1) @ planes
            weights = share / share.sum(-1, keepdims=True)
            depth = weights @ p[:, 2] / (weights @ p[:, 3])
            inside = (share >= 0).all(-1) & (depth < nearest) & (np.abs(depth) <= 1)
            nearest[inside] = depth[inside]
            rast[inside] = np.concatenate(
                (weights[..., :2], depth[..., None], np.full_like(depth, number + 1)[..., None]), -1
            )[inside]
        return rast

    @staticmethod
    def interpolate(attr: np.ndarray, rast: np.ndarray, tri: np.ndarray) -> np.ndarray:
        corners = attr[tri[rast[..., 3].astype(int) - 1]]
        u, v = rast[..., 0:1], rast[..., 1:2]
        mixed = u * corners[..., 0, :] + v * corners[..., 1, :] + (1 - u - v) * corners[..., 2, :]
        return np.where(rast[..., 3:] > 0, mixed, 0)


def test_nvdiffrast_gives_the_same_numbers() -> None:
    given = names("from_nvdiffrast.md")
    pos, tri, attr = (given[name].double().numpy() for name in ("pos", "tri", "attr"))
    tri = tri.astype(int)
    rast = Nvdiffrast.rasterize(pos, tri, given["H"], given["W"])[::-1]
    for row in rows("from_nvdiffrast.md"):
        if "nr.fragments" not in row[1] or "fragments = " not in row[1]:
            continue
        run(row[1], given)
        fragments = given["fragments"]
        same = (fragments.face_index[0] + 1).numpy() == rast[..., 3]
        assert same.mean() > 0.99  # a pixel whose centre is on an edge may show either face
        same &= rast[..., 3] > 0
        assert same.mean() > 0.2
        np.testing.assert_allclose(fragments.weights[0, ..., :2].numpy()[same], rast[same][:, :2], atol=1e-3)
        expected = Nvdiffrast.interpolate(attr, rast, tri)
        np.testing.assert_allclose(fragments.interpolate(given["attr"])[0].numpy()[same], expected[same], atol=1e-3)
        near, far = given["near"], given["far"]
        ndc = (far + near) / (far - near) - 2 * far * near / (far - near) / fragments.depth[0].numpy()
        np.testing.assert_allclose(ndc[same], rast[same][:, 2], atol=1e-4)
    uv = torch.rand(1, 9, 9, 2)
    # Texel centres are at half texels; the first row is v = 0 there, v = 1 here.
    tex = given["tex"].double().numpy()
    x, y = uv[0, ..., 0].numpy() * 32 - 0.5, uv[0, ..., 1].numpy() * 32 - 0.5
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - left)[..., None], (y - top)[..., None]
    wrapped = np.pad(tex, ((1, 1), (1, 1), (0, 0)), mode="wrap")  # the image repeats
    upper = (1 - fx) * wrapped[top + 1, left + 1] + fx * wrapped[top + 1, left + 2]
    lower = (1 - fx) * wrapped[top + 2, left + 1] + fx * wrapped[top + 2, left + 2]
    expected = (1 - fy) * upper + fy * lower
    found = nr.sample_texture(given["tex"], torch.stack((uv[..., 0], 1 - uv[..., 1]), -1))[0]
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-4)


def pytorch3d_view(dist: float, elev: float, azim: float) -> tuple[np.ndarray, np.ndarray]:
    """R and T of `look_at_view_transform`, from its documentation: rows of points are multiplied from the right."""
    e, a = math.radians(elev), math.radians(azim)
    eye = dist * np.array([math.cos(e) * math.sin(a), math.sin(e), math.cos(e) * math.cos(a)])
    z = -eye / np.linalg.norm(eye)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    R = np.stack((x, np.cross(z, x), z), 1)
    return R, -R.T @ eye


def test_pytorch3d_gives_the_same_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    given = names("from_pytorch3d.md")
    R, T = pytorch3d_view(given["dist"], given["elev"], given["azim"])
    for code in ("look_at_view_transform", "FoVPerspectiveCameras(R=R, T=T, fov=60)`", "transform_points_screen"):
        (row,) = [row for row in rows("from_pytorch3d.md") if code in row[0] and "your own" not in row[0]]
        run(row[1].replace("`fov`", ""), given)
    height, width = given["size"]
    view = given["points"].double().numpy() @ R + T
    # NDC: x to the left, y up, the shorter side is [−1, 1]; `fov` is the vertical angle.
    f = 1 / math.tan(math.radians(30))
    screen = np.stack((-f * view[:, 0] / view[:, 2], -f * view[:, 1] / view[:, 2]), 1) * height / 2
    pixels = screen + np.array([width / 2, height / 2])
    np.testing.assert_allclose(given["pixels"][0], pixels, atol=1e-3)
    np.testing.assert_allclose(given["depth"][0], view[:, 2], atol=1e-5)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[3, :3] = R, T
    own = nr.Camera.from_matrix(world_to_camera=matrix, convention="pytorch3d", viewing_angle=30)
    np.testing.assert_allclose(own.project(given["points"], given["size"])[0][0], pixels, atol=1e-3)
    vertices, faces = given["vertices"].double(), given["faces"].long()
    edges = torch.unique(torch.cat((faces[:, :2], faces[:, 1:], faces[:, [2, 0]])).sort(1).values, dim=0)
    lengths = (vertices[edges[:, 0]] - vertices[edges[:, 1]]).norm(dim=1)
    torch.testing.assert_close(nr.losses.edge_length(vertices, faces), (lengths**2).mean())
    neighbours = torch.zeros(len(vertices), len(vertices), dtype=torch.float64)
    neighbours[edges[:, 0], edges[:, 1]] = neighbours[edges[:, 1], edges[:, 0]] = 1
    uniform = neighbours / neighbours.sum(1, keepdim=True) @ vertices - vertices  # PyTorch3D's mean of the norms
    torch.testing.assert_close(nr.losses.laplacian(vertices, faces), uniform.square().sum(1).mean())
