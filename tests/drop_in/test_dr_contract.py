"""The contract with programs written for nvdiffrast: names, arguments, defaults, and errors, call by call."""

from __future__ import annotations

import inspect
from typing import Any

import pytest
import torch

import neural_renderer.nvdiffrast as dr
from tests.drop_in.scenes import CONTEXT, fan

# The signatures of nvdiffrast's documentation.
SIGNATURES = {
    "RasterizeCudaContext": "device=None",
    "RasterizeGLContext": "output_db=True, mode='automatic', device=None",
    "rasterize": "glctx, pos, tri, resolution, ranges=None, grad_db=True",
    "DepthPeeler": "glctx, pos, tri, resolution, ranges=None, grad_db=True",
    "interpolate": "attr, rast, tri, rast_db=None, diff_attrs=None",
    "texture": "tex, uv, uv_da=None, mip_level_bias=None, mip=None, filter_mode='auto', boundary_mode='wrap', "
    "max_mip_level=None",
    "texture_construct_mip": "tex, max_mip_level=None, cube_mode=False",
    "antialias": "color, rast, pos, tri, topology_hash=None, pos_gradient_boost=1.0",
    "antialias_construct_topology_hash": "tri",
    "get_log_level": "",
    "set_log_level": "level",
}

POS, TRI = fan(0)
RAST, RAST_DB = dr.rasterize(CONTEXT, POS, TRI, (8, 8))
ATTR, TEX, CUBE = torch.rand(1, 8, 3), torch.rand(1, 8, 8, 3), torch.rand(1, 6, 8, 8, 3)
UV, UV_DA, COLOR = torch.rand(1, 8, 8, 2), torch.rand(1, 8, 8, 4), torch.rand(1, 8, 8, 3)


@pytest.mark.parametrize("name", SIGNATURES)
def test_signatures(name: str) -> None:
    given = inspect.signature(getattr(dr, name)).parameters.values()
    plain = ", ".join(
        one.name if one.default is inspect.Parameter.empty else f"{one.name}={one.default!r}" for one in given
    )
    assert plain == SIGNATURES[name]
    assert name in dr.__all__


def test_no_other_names() -> None:
    assert set(dr.__all__) == set(SIGNATURES)


WRONG: dict[str, tuple[Any, str]] = {
    "no context": (lambda: dr.rasterize(None, POS, TRI, (8, 8)), "glctx: expected a RasterizeCudaContext"),
    "pos of doubles": (lambda: dr.rasterize(CONTEXT, POS.double(), TRI, (8, 8)), "pos: expected float32"),
    "pos of three": (lambda: dr.rasterize(CONTEXT, POS[..., :3], TRI, (8, 8)), r"pos: expected shape \[B, V, 4\]"),
    "tri of int64": (lambda: dr.rasterize(CONTEXT, POS, TRI.long(), (8, 8)), "tri: expected int32"),
    "tri with a batch": (lambda: dr.rasterize(CONTEXT, POS, TRI[None], (8, 8)), r"tri: expected shape \[F, 3\]"),
    "tri out of range": (lambda: dr.rasterize(CONTEXT, POS, TRI + 5, (8, 8)), r"tri: expected indices in \[0, 8\)"),
    "one number as the size": (lambda: dr.rasterize(CONTEXT, POS, TRI, 8), r"resolution: expected \(height, width\)"),
    "an empty image": (lambda: dr.rasterize(CONTEXT, POS, TRI, (8, 0)), "resolution: expected"),
    "no ranges": (lambda: dr.rasterize(CONTEXT, POS[0], TRI, (8, 8)), "ranges: expected a tensor"),
    "ranges of int64": (
        lambda: dr.rasterize(CONTEXT, POS[0], TRI, (8, 8), ranges=torch.tensor([[0, 2]])),
        "ranges: expected int32 on the CPU",
    ),
    "ranges beyond the triangles": (
        lambda: dr.rasterize(CONTEXT, POS[0], TRI, (8, 8), ranges=torch.tensor([[4, 3]]).int()),
        "ranges: expected first triangles and numbers within 6",
    ),
    "attributes of another batch": (
        lambda: dr.interpolate(ATTR.expand(3, -1, -1), RAST.expand(2, -1, -1, -1), TRI),
        "attr: expected a batch of 1 or 2 like rast",
    ),
    "a name for attributes": (
        lambda: dr.interpolate(ATTR, RAST, TRI, RAST_DB, "some"),
        "diff_attrs: expected 'all' or numbers",
    ),
    "an attribute that does not exist": (
        lambda: dr.interpolate(ATTR, RAST, TRI, RAST_DB, [3]),
        "diff_attrs: expected numbers below 3",
    ),
    "an unknown filter": (lambda: dr.texture(TEX, UV, filter_mode="cubic"), "filter_mode: expected 'auto' or one of"),
    "an unknown boundary": (lambda: dr.texture(TEX, UV, boundary_mode="repeat"), "boundary_mode: expected one of"),
    "mipmaps without a footprint": (
        lambda: dr.texture(TEX, UV, filter_mode="linear-mipmap-linear"),
        "filter_mode: expected uv_da or mip_level_bias",
    ),
    "a cube map without its boundary": (lambda: dr.texture(CUBE, UV), r"tex: expected shape \[B, h, w, C\]"),
    "coordinates for a cube map": (
        lambda: dr.texture(CUBE, UV, boundary_mode="cube"),
        r"uv: expected shape \[B, H, W, 3\]",
    ),
    "a footprint of another shape": (lambda: dr.texture(TEX, UV, UV_DA[..., :2]), "uv_da: expected shape"),
    "mipmaps of another size": (
        lambda: dr.texture(TEX, UV, UV_DA, mip=[torch.rand(1, 3, 4, 3)]),
        r"mip\[0\]: expected shape \[1, 4, 4, 3\]",
    ),
    "mipmaps of a cube map": (
        lambda: dr.texture(TEX, UV, UV_DA, mip=dr.texture_construct_mip(CUBE, cube_mode=True)),
        "mip: expected mipmaps made with cube_mode=False",
    ),
    "a topology of other triangles": (
        lambda: dr.antialias(COLOR, RAST, POS, TRI, dr.antialias_construct_topology_hash(TRI[:2])),
        "topology_hash: expected that of 6 triangles, got 2",
    ),
    "another object as a topology": (lambda: dr.antialias(COLOR, RAST, POS, TRI, TRI), "topology_hash: expected the"),
    "a smaller image": (lambda: dr.antialias(COLOR[:, :4], RAST, POS, TRI), "rast: expected shape"),
    "a mode of OpenGL": (lambda: dr.RasterizeGLContext(mode="fast"), "mode: expected 'automatic' or 'manual'"),
    "a level of messages": (lambda: dr.set_log_level(7), "level: expected 0 to 3"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_arguments(case: str) -> None:
    call, message = WRONG[case]
    with pytest.raises((TypeError, ValueError), match=f"^{message}"):
        call()


def test_context_of_opengl() -> None:
    context = dr.RasterizeGLContext(output_db=False, mode="manual", device="cuda")
    context.set_context()
    rast, rast_db = dr.rasterize(context, POS, TRI, [8, 8])
    context.release_context()
    assert torch.equal(rast, RAST) and rast_db.shape == (1, 8, 8, 0)


def test_log_level_is_kept() -> None:
    assert dr.get_log_level() == 1
    dr.set_log_level(3)
    assert dr.get_log_level() == 3
    dr.set_log_level(1)


def test_auto_filter() -> None:
    """It is "linear", or with a footprint or a level "linear-mipmap-linear"."""
    level = torch.rand(1, 8, 8) * 2
    assert torch.equal(dr.texture(TEX, UV), dr.texture(TEX, UV, filter_mode="linear"))
    for given in ({"uv_da": UV_DA}, {"mip_level_bias": level}):
        assert torch.equal(
            dr.texture(TEX, UV, **given), dr.texture(TEX, UV, **given, filter_mode="linear-mipmap-linear")
        )


def test_inputs_stay_as_they_are() -> None:
    before = [one.clone() for one in (POS, TRI, ATTR, TEX, UV, COLOR)]
    rast, rast_db = dr.rasterize(CONTEXT, POS, TRI, (8, 8))
    dr.interpolate(ATTR, rast, TRI, rast_db, "all")
    dr.texture(TEX, UV, UV_DA)
    dr.antialias(COLOR, rast, POS, TRI)
    assert all(torch.equal(one, other) for one, other in zip(before, (POS, TRI, ATTR, TEX, UV, COLOR), strict=True))


def test_strided_inputs() -> None:
    """Tensors need not be contiguous."""
    wide = torch.stack((POS, POS), -1)
    rast, rast_db = dr.rasterize(CONTEXT, wide[..., 0], TRI.T.contiguous().T, (8, 8))
    assert torch.equal(rast, RAST) and torch.equal(rast_db, RAST_DB)
    flipped = COLOR.flip(3).flip(3).transpose(1, 2).contiguous().transpose(1, 2)
    assert torch.equal(dr.antialias(flipped, rast, POS, TRI), dr.antialias(COLOR, RAST, POS, TRI))


@pytest.mark.parametrize(
    "name", ["show_triangles", "interpolate_attributes", "halve_levels", "sample_levels", "blend_silhouettes"]
)
def test_operators_are_well_formed(name: str) -> None:
    from neural_renderer.raster.clip import attributes, silhouettes, texture_levels, triangles
    from neural_renderer.raster.ops.half_edges import find_half_edges

    pos, attr = POS.clone().requires_grad_(), ATTR.clone().requires_grad_()
    given: dict[str, tuple[Any, tuple[Any, ...]]] = {
        "show_triangles": (triangles.show_triangles, (pos, TRI, None, 6, 8, 8, torch.full((1, 8, 8), 1.5))),
        "interpolate_attributes": (
            attributes.interpolate_attributes,
            (attr, RAST.clone().requires_grad_(), TRI, RAST_DB.clone().requires_grad_(), 2, torch.tensor([0, 2]).int()),
        ),
        "halve_levels": (texture_levels.halve_levels, (torch.rand(1, 6, 4, 4, 2, requires_grad=True), 3)),
        "sample_levels": (
            texture_levels.sample_levels,
            (torch.rand(1, 20, 3, requires_grad=True), UV, UV_DA, None, [4, 4, 2], 3, [0, 1]),
        ),
        "blend_silhouettes": (
            silhouettes.blend_silhouettes,
            (COLOR.clone().requires_grad_(), RAST, pos, TRI, find_half_edges(TRI).siblings, 1.0),
        ),
    }
    call, arguments = given[name]
    torch.library.opcheck(call.operator, arguments)
