"""The page for users of the first packages: both columns, which run here, show the same.

That the left column shows what the first packages showed is checked in tests/compat, with golden images of theirs.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch

import neural_renderer as nr
from tests.coming_from.pages import Page, needs_pages, run
from tests.rounding import rounding

pytestmark = needs_pages
PAGE = Page("from_neural_renderer.md")


@pytest.fixture
def given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    monkeypatch.chdir(tmp_path)
    names = PAGE.names()
    names["camera"] = nr.Camera.look_at(names["eye"], mirrored=True)
    names["renderer"].eye = names["eye"]
    return names


def test_every_row_has_a_check() -> None:
    assert not PAGE.missing()


@pytest.mark.parametrize("left", PAGE.rows)
def test_row(left: str, given: dict[str, Any]) -> None:
    given["left"] = run(left, given)
    PAGE.check(left, given)


def draw(given: dict[str, Any], **modern: Any) -> None:
    """Assert that the renderer draws what `render` draws with these arguments."""
    images = nr.render(given["mesh"], given["camera"], 64, **{"light": nr.Light(), **modern})
    parts = (given["vertices"], given["faces"], given["textures"])
    with torch.no_grad():
        rgb, depth, alpha = given["renderer"](*parts)
    for old, new in ((rgb, images.rgb), (alpha, images.alpha), (depth, images.depth)):
        # Depth is up to 100 at outlines.
        torch.testing.assert_close(old, new.detach(), **rounding(64, 100))


@PAGE.row("`nr.load_obj(")
def _(given, values):
    vertices, faces, textures = given["left"][0]
    mesh = values[0].normalize()
    torch.testing.assert_close(mesh.vertices, vertices, **rounding(16))
    assert torch.equal(mesh.faces, faces)
    torch.testing.assert_close(mesh.textures, textures)


@PAGE.row("images, for textures")
def _(given, values):
    assert torch.equal(values[0].vertices, given["mesh"].vertices)


@PAGE.row("the paper's gradient")
def _(given, values):
    # `Renderer` and `render` with "nmr" have the same gradient.
    weight = torch.rand(values[0].rgb.shape)
    (values[0].rgb * weight).sum().backward()
    modern = given["mesh"].vertices.grad.clone()
    given["mesh"].zero_grad()
    given["camera"] = nr.Camera.look_at(given["eye"], mirrored=True)
    rgb, _, _ = given["renderer"](given["vertices"], given["faces"], given["textures"])
    (rgb * weight).sum().backward()
    torch.testing.assert_close(given["mesh"].vertices.grad, modern, rtol=1e-3, atol=1e-3 * float(modern.abs().max()))


@PAGE.row("none")
def _(given, values):
    draw(given)
    face_index = values[0].face_index[0]
    with torch.no_grad():
        _, _, alpha = given["renderer"](given["vertices"], given["faces"], given["textures"])
    assert (face_index[alpha[0] == 1] >= 0).all() and (face_index[alpha[0] == 0] == -1).all()


@PAGE.row("`nr.save_obj(")
def _(given, values):
    old = nr.load_obj(given["path"], load_texture=True, normalization=False)
    assert torch.equal(old[0], given["mesh"].vertices) and torch.equal(old[1], given["mesh"].faces)


@PAGE.row("`nr.Mesh(path)`")
def _(given, values):
    torch.testing.assert_close(given["left"][0].vertices.detach(), values[0].vertices, **rounding(16))


@PAGE.row("`renderer.eye = eye`")
def _(given, values):
    draw(given)


@PAGE.row("`renderer(vertices, faces, textures)`")
def _(given, values):
    draw(given)
    torch.testing.assert_close(given["left"][0][0].detach(), values[0].rgb.detach(), **rounding(64))


@PAGE.row('`renderer(vertices, faces, mode="silhouettes")`', '`renderer(vertices, faces, mode="depth")`')
def _(given, values):
    torch.testing.assert_close(given["left"][0].detach(), values[0].detach(), **rounding(64, 100))


@PAGE.row("`nr.look_at(vertices, eye)`")
def _(given, values):
    # The old one is before the projection.
    torch.testing.assert_close(nr.perspective(given["left"][0]), values[0], **rounding(64, 4))


@PAGE.row("`renderer.perspective = False`")
def _(given, values):
    given["camera"] = nr.Camera.look_at(given["eye"], orthographic=True, scale=1.0, mirrored=True)
    draw(given)
    assert not values[0].perspective


@PAGE.row("`nr.projection(")
def _(given, values):
    K, R, t = (part[None] for part in (given["K"], given["R"], given["t"]))
    with torch.no_grad():
        old = nr.projection(given["vertices"], K, R, t[:, None], torch.zeros(1, 5), 1024)
        torch.testing.assert_close(values[0](given["mesh"].vertices), old, **rounding(64, 4))


@PAGE.row("`renderer.light_direction = [0, 1, -1]`")
def _(given, values):
    draw(given, light=values[0])


@PAGE.row("`renderer.background_color = [1, 1, 1]`")
def _(given, values):
    draw(given, background=1.0)


@PAGE.row("`renderer.fill_back = True`")
def _(given, values):
    draw(given, two_sided=True)
    given["renderer"].fill_back = False
    draw(given, two_sided=False)


@PAGE.row("`renderer.anti_aliasing = False`")
def _(given, values):
    draw(given, anti_aliasing=False)


@PAGE.row("`mesh.get_batch(4)`")
def _(given, values):
    vertices, faces, textures = given["left"][0]
    mesh = given["mesh"].replace(textures=torch.sigmoid(given["mesh"].textures))
    with torch.no_grad():
        old, _, _ = given["renderer"](vertices, faces, textures)
    rgb = nr.render(mesh, given["camera"][[0, 0, 0, 0]], 64, light=nr.Light()).rgb.detach()
    torch.testing.assert_close(old, rgb, **rounding(64))


@PAGE.row("`mesh.set_lr(0.1, 1.0)`", "`nr.Adam(mesh.parameters())`")
def _(given, values):
    # One step of Adam moves each number by its rate, whatever the gradient.
    mesh = nr.Mesh.icosphere(1).trainable()
    mesh.set_lr(0.1, 1.0)
    groups = [{"params": mesh.vertices, "lr": 0.1}, {"params": mesh.textures, "lr": 1.0}]
    assert [group["lr"] for group in groups] == [getattr(part, "lr", None) for part in (mesh.vertices, mesh.textures)]
    start = [part.detach().clone() for part in mesh.parameters()]
    moved = []
    for make in (
        lambda: nr.Adam(mesh.parameters(), lr=0.01),
        lambda: torch.optim.Adam(
            [{"params": mesh.vertices, "lr": 0.001}, {"params": mesh.textures, "lr": 0.01}], betas=(0.5, 0.999)
        ),
    ):
        with torch.no_grad():
            for part, first in zip(mesh.parameters(), start, strict=True):
                part.copy_(first)
        for part in mesh.parameters():
            part.grad = torch.ones_like(part)
        make().step()
        moved.append([part.detach() - first for part, first in zip(mesh.parameters(), start, strict=True)])
    for old, new in zip(*moved, strict=True):
        torch.testing.assert_close(old, new, rtol=1e-3, atol=1e-7)
