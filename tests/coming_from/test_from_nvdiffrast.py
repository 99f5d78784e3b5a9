"""The page for users of nvdiffrast: each row shows what nvdiffrast shows.

Formulas are those of its documentation (Laine et al., "Modular Primitives for High-Performance Differentiable
Rendering", 2020), written here in float64 and by brute force.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

import neural_renderer as nr
from tests.coming_from.pages import Page, needs_pages, run, same_but_at_edges
from tests.rounding import rounding

pytestmark = needs_pages
PAGE = Page("from_nvdiffrast.md")
AT_EDGES = 0.01


def rasterize(pos: Tensor, tri: Tensor, height: int, width: int) -> Tensor:
    """`dr.rasterize`: (u, v, z / w, triangle + 1) of each pixel, [height, width, 4]; row 0 is at the bottom."""
    pos, tri = pos.double(), tri.long()
    rast, nearest = torch.zeros(height, width, 4).double(), torch.full((height, width), torch.inf).double()
    y, x = torch.meshgrid(*((2 * torch.arange(n).double() + 1) / n - 1 for n in (height, width)), indexing="ij")
    pixels, size = torch.stack((x, y, torch.ones_like(x)), -1), torch.tensor([width, height])
    for number, triangle in enumerate(tri):
        p = pos[triangle]
        low, high = torch.aminmax((p[:, :2] / p[:, 3:] + 1) * size / 2, dim=0)  # all are in front of the camera
        (left, bottom), (right, top) = low.long().clamp(min=0).tolist(), (high.long() + 1).clamp(min=0).tolist()
        box = slice(bottom, top), slice(left, right)
        share = pixels[box] @ torch.linalg.inv(p[:, [0, 1, 3]])
        weights = share / share.sum(-1, keepdim=True)
        depth = weights @ p[:, 2] / (weights @ p[:, 3])
        inside = (share >= 0).all(-1) & (depth < nearest[box]) & (depth.abs() <= 1)
        nearest[box][inside] = depth[inside]
        label = torch.full_like(depth, number + 1)
        rast[box][inside] = torch.cat((weights[..., :2], depth[..., None], label[..., None]), -1)[inside]
    return rast


def interpolate(attr: Tensor, rast: Tensor, tri: Tensor) -> Tensor:
    """`dr.interpolate`: u · a0 + v · a1 + (1 − u − v) · a2, 0 without a triangle."""
    corners = attr.double()[tri.long()[rast[..., 3].long() - 1]]
    u, v = rast[..., 0:1], rast[..., 1:2]
    mixed = u * corners[..., 0, :] + v * corners[..., 1, :] + (1 - u - v) * corners[..., 2, :]
    return torch.where(rast[..., 3:] > 0, mixed, 0.0)


def texture(tex: Tensor, uv: Tensor, clamp: bool = False) -> Tensor:
    """`dr.texture`, bilinear between the centres of texels; (0, 0) is the corner of the first texel in memory."""
    height, width = tex.shape[:2]
    x, y = uv[..., 0].double() * width - 0.5, uv[..., 1].double() * height - 0.5
    left, top = x.floor().long(), y.floor().long()

    def at(i: Tensor, j: Tensor) -> Tensor:
        i, j = (i.clamp(0, width - 1), j.clamp(0, height - 1)) if clamp else (i % width, j % height)
        return tex.double()[j, i]

    across, down = (x - left)[..., None], (y - top)[..., None]
    upper = (1 - across) * at(left, top) + across * at(left + 1, top)
    return (1 - down) * upper + down * ((1 - across) * at(left, top + 1) + across * at(left + 1, top + 1))


def mipmapped(tex: Tensor, uv: Tensor, step: float, most: int) -> Tensor:
    """`dr.texture` with ``uv_da`` of ``step`` texels a pixel: a blend of the two mipmaps of next size."""
    level = min(max(float(np.log2(step)), 0.0), most)
    low = int(level)
    result = torch.zeros(())
    for n in (low, low + 1):
        share = max(0.0, 1 - abs(level - n))
        if share:
            small = tex.double().movedim(-1, 0)
            for _ in range(n):
                small = avg_pool2d(small, 2)
            result = result + share * texture(small.movedim(0, -1), uv)
    return result


def flipped(uv: Tensor) -> Tensor:
    return torch.stack((uv[..., 0], 1 - uv[..., 1]), -1)


def own_rast(given: dict[str, Any], scale: int = 1) -> Tensor:
    """What `dr.rasterize` gives, with row 0 at the top."""
    return rasterize(given["pos"], given["tri"], scale * given["H"], scale * given["W"]).flip(0)


@pytest.fixture
def given() -> dict[str, Any]:
    names = PAGE.names()
    for left in PAGE.rows:
        if any(start in left for start in ("dr.rasterize(", "before `dr", "(uv_attr", "`dr.texture(tex, uv)`")):
            run(PAGE.rows[left], names)
    return names


def test_every_row_has_a_check() -> None:
    assert not PAGE.missing()


@pytest.mark.parametrize("left", PAGE.rows)
def test_row(left: str, given: dict[str, Any]) -> None:
    PAGE.check(left, given)


def test_the_range_is_that_of_the_matrix(given: dict[str, Any]) -> None:
    assert given["near"] == pytest.approx(0.1, rel=1e-5) and given["far"] == pytest.approx(10.0, rel=1e-5)
    for near, far in ((0.1, 10.0), (0.5, 2.9)):  # the second one cuts the sphere through its middle
        z = (far + near) / (near - far), 2 * far * near / (near - far)
        projection = torch.tensor([[1.5, 0, 0, 0], [0, 2, 0, 0], [0, 0, *z], [0, 0, -1, 0]])
        mvp = projection @ given["view"]
        pos = torch.cat((given["vertices"], torch.ones(len(given["vertices"]), 1)), 1) @ mvp.T
        rast = rasterize(pos, given["tri"], given["H"], given["W"]).flip(0)
        for matrix in (projection, mvp):
            own = dict(zip(("near", "far"), nr.Camera.clip_range(matrix), strict=True))
            for mesh, camera in (((pos, given["tri"]), None), ((given["vertices"], given["tri"]), given["mvp"])):
                camera = camera if camera is None else nr.Camera.from_clip(mvp)
                fragments = nr.fragments(mesh, camera, (given["H"], given["W"]), anti_aliasing=False, **own)
                same_but_at_edges(fragments.face_index[0] + 1, rast[..., 3], 0.0, AT_EDGES)


@PAGE.row("`dr.RasterizeCudaContext()`")
def _(given, values):
    assert not values


@PAGE.row("`dr.rasterize(", "the same, with world vertices", "`rast[..., 3]`", "`rast[..., 0:2]`", "`rast[..., 2]`")
def _(given, values):
    rast, fragments = own_rast(given), given["fragments"]
    same_but_at_edges(fragments.face_index[0] + 1, rast[..., 3], 0.0, AT_EDGES)
    same = (fragments.face_index[0] + 1 == rast[..., 3]) & (rast[..., 3] > 0)
    assert same.double().mean() > 0.2
    torch.testing.assert_close(fragments.weights[0][same][:, :2].double(), rast[same][:, :2], rtol=0, atol=1e-3)
    near, far = given["near"], given["far"]
    ndc = (far + near) / (far - near) - 2 * far * near / (far - near) / fragments.depth[0].double()
    torch.testing.assert_close(ndc[same], rast[same][:, 2], rtol=0, atol=1e-5)


@PAGE.row("the same, before `dr.antialias`")
def _(given, values):
    same_but_at_edges(given["smooth"].face_index[0] + 1, own_rast(given, 2)[..., 3], 0.0, AT_EDGES)


@PAGE.row("`dr.interpolate(attr, rast, tri)`")
def _(given, values):
    same_but_at_edges(values[0][0], interpolate(given["attr"], own_rast(given), given["tri"]), 1e-3, AT_EDGES)


@PAGE.row("`dr.interpolate(uv_attr")
def _(given, values):
    expected = interpolate(given["uv_attr"], own_rast(given), given["uv_tri"])
    same_but_at_edges(given["uv"][0], expected, 1e-3, AT_EDGES)


def ramp() -> tuple[Tensor, Tensor]:
    """Texture coordinates that move by 4 · √2 texels of 32 a pixel along x, and by none along y; and one face."""
    uv = torch.zeros(1, 6, 24, 2)
    uv[..., 0] = torch.arange(24) * 4 * 2**0.5 / 32
    uv[..., 1] = 0.3
    return uv, torch.zeros(1, 6, 24, dtype=torch.int32)


@PAGE.row("`dr.interpolate(…, rast_db", "`dr.texture(tex, uv, uv_da)`", "`dr.texture(tex, uv, uv_da, max_mip_level=2)`")
def _(given, values):
    uv, face_index = ramp()
    for limit, most in ((None, 5), (2, 2), (0, 0)):
        found = nr.sample_texture(given["tex"], uv, face_index, max_mip_level=limit)
        expected = mipmapped(given["tex"], flipped(uv), 4 * 2**0.5, most)
        torch.testing.assert_close(found.double(), expected, **rounding(2048))
    assert values[-1].shape == (1, given["H"], given["W"], 3)


@PAGE.row("`dr.texture(tex, uv)`, without")
def _(given, values):
    uv = 3 * torch.rand(1, 9, 9, 2) - 1
    found = nr.sample_texture(given["tex"], flipped(uv))
    torch.testing.assert_close(found.double(), texture(given["tex"], uv), **rounding(1024))
    shown = given["fragments"].mask[0]
    expected = texture(given["tex"], flipped(given["uv"][0]))[shown]
    torch.testing.assert_close(given["color"][0][shown].double(), expected, **rounding(1024))


@PAGE.row('`dr.texture(tex, uv, boundary_mode="clamp")`')
def _(given, values):
    uv = 3 * torch.rand(1, 9, 9, 2) - 1
    found = nr.sample_texture(given["tex"], flipped(uv), wrap="clamp")
    torch.testing.assert_close(found.double(), texture(given["tex"], uv, True), **rounding(1024))
    assert values[0].shape == (1, given["H"], given["W"], 3)


@PAGE.row("`dr.texture(cube, directions")
def _(given, values):
    # A cube map's faces are those of +x, −x, +y, −y, +z and −z, as its documentation orders them.
    axes = torch.tensor([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    plain = torch.rand(6, 1, 1, 3).expand(6, 4, 4, 3)
    found = nr.sample_texture(plain, axes[None, None])[0, 0]
    torch.testing.assert_close(found, plain[:, 0, 0], **rounding(16))
    assert values[0].shape == (1, given["H"], given["W"], 3)


@PAGE.row("`dr.antialias(")
def _(given, values):
    # nvdiffrast blends a pixel with its neighbour by the place of the edge between their centres, an estimate of the
    # covered area. Both are that area up to the step of one sample; inside they are equal.
    rast = own_rast(given, 2)
    expected = avg_pool2d(interpolate(given["attr"], rast, given["tri"]).movedim(-1, 0), 2)
    same_but_at_edges(values[0][0], expected, 1e-3, AT_EDGES)
    jagged = interpolate(given["attr"], own_rast(given), given["tri"]).movedim(-1, 0)
    whole = torch.nn.functional.max_pool2d((rast[..., 3] == 0).double()[None], 4, 2, 1)[0] == 0
    assert (values[0][0] - jagged)[:, whole].abs().mean() < 0.02


@PAGE.row("no `dr.antialias`")
def _(given, values):
    rast = own_rast(given)
    expected = texture(given["tex"], flipped(interpolate(given["uv_attr"], rast, given["uv_tri"])))
    expected = torch.where(rast[..., 3:] > 0, expected, 0.0).movedim(-1, 0)
    # The change of a colour is up to 32 times that of its texture coordinates.
    same_but_at_edges(values[0][0], expected, 0.03, 2 * AT_EDGES)


@PAGE.row("`dr.DepthPeeler`")
def _(given, values):
    pos, tri, rest = given["pos"], given["tri"], own_rast(given)
    same_but_at_edges(values[0][0].face_index[0] + 1, rest[..., 3], 0.0, AT_EDGES)
    # The second layer of a convex mesh is what remains without the faces in front.
    p = pos[tri.long()].double()[..., [0, 1, 3]]
    behind = (torch.linalg.det(p) < 0).nonzero()[:, 0]
    first = torch.isin(torch.arange(len(tri)), rest[..., 3].long() - 1)
    behind = behind if not first[behind].any() else (torch.linalg.det(p) > 0).nonzero()[:, 0]
    rast = rasterize(pos, tri[behind], given["H"], given["W"]).flip(0)[..., 3].long()
    expected = torch.where(rast > 0, behind[rast - 1] + 1, 0)
    same_but_at_edges(values[0][1].face_index[0] + 1, expected, 0.0, AT_EDGES)


@PAGE.row("`pos` in range mode")
def _(given, values):
    for n, mesh in enumerate((given["mesh"], nr.Mesh.icosphere(1))):
        pos = torch.cat((mesh.vertices, torch.ones(len(mesh.vertices), 1)), 1) @ given["mvp"].T
        rast = rasterize(pos, mesh.faces, given["H"], given["W"]).flip(0)
        same_but_at_edges(values[0].face_index[n] + 1, rast[..., 3], 0.0, AT_EDGES)


@PAGE.row("minibatch mode")
def _(given, values):
    expected = own_rast(given)[..., 3].expand(2, -1, -1)
    same_but_at_edges(values[0].face_index + 1, expected, 0.0, AT_EDGES)
