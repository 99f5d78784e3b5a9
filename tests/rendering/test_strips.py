"""Images drawn strip by strip: equal to the whole image, to the bit, with its gradients; and streamed to a PNG file."""

from __future__ import annotations

import io

import numpy as np
import pytest
import torch
from PIL import Image

import neural_renderer as nr
from neural_renderer.apps.render import command as command
from neural_renderer.io.image_formats.png import encode_png, save_png_strips
from neural_renderer.rendering.forward import render_rows

SIZE = (90, 64)
# The same terms in another order and of both signs, whose sum is some hundred times less than they are. Places of
# edges, rounded in the rows of a strip, count up to fifty times more in chords shorter than a pixel.
ROUNDING = 1e-4
OUTPUTS = ("rgb", "alpha", "depth", "normal", "position", "face_index", "barycentric")


def scene(kind):
    """A mesh with its leaves."""
    generator = torch.Generator().manual_seed(0)
    vertices, faces = nr.icosphere(3)
    vertices = (vertices * (1 + 0.1 * torch.rand(len(vertices), 1, generator=generator))).requires_grad_()
    if kind == "cubes":
        colors = torch.rand(len(faces), 2, 2, 2, 3, generator=generator).requires_grad_()
        mesh = nr.Mesh(vertices, faces, colors)
    elif kind == "vertex colours":
        colors = torch.rand(len(vertices), 3, generator=generator).requires_grad_()
        mesh = nr.Mesh(vertices, faces, vertex_colors=colors)
    else:
        colors = torch.rand(64, 64, 3, generator=generator).requires_grad_()
        mesh = nr.UVMesh(vertices, faces, torch.rand(len(faces), 3, 2, generator=generator), colors)
    return mesh, [vertices, colors]


@pytest.mark.parametrize("anti_aliasing", [True, False])
@pytest.mark.parametrize(
    ("kind", "shading", "background"),
    [("cubes", "flat", 0.5), ("vertex colours", "flat", "image"), ("image", "flat", "image"), ("image", "smooth", 0.0)],
)
def test_strips_equal_the_whole_image(kind, shading, background, anti_aliasing):
    mesh, leaves = scene(kind)
    generator = torch.Generator().manual_seed(1)
    if background == "image":
        background = torch.rand(3, *SIZE, generator=generator).requires_grad_()
        leaves.append(background)
    camera = nr.Camera.look_at(torch.tensor([[0.3, 0.8, -2.2], [1.5, 0.2, -2.0]]))
    options = {"shading": shading, "outputs": OUTPUTS, "anti_aliasing": anti_aliasing, "light": nr.Light(0.5, 0.5)}
    drawn = [nr.render(mesh, camera, SIZE, background=background, tile=tile, **options) for tile in (None, 32)]
    for name in OUTPUTS:
        assert torch.equal(*(getattr(images, name) for images in drawn)), name
    found = []
    for images in drawn:
        random = torch.Generator().manual_seed(2)
        loss = sum((getattr(images, name) * torch.randn(3, *SIZE, generator=random)[:1]).sum() for name in OUTPUTS[:5])
        found.append(torch.autograd.grad(loss, leaves))
    for whole, strips in zip(*found, strict=True):
        assert (strips - whole).norm() < ROUNDING * whole.norm()


@pytest.mark.parametrize("recorded", [True, False])
@pytest.mark.parametrize("kind", ["cubes", "vertex colours", "image"])
def test_strips_in_transformations(kind, recorded):
    """Forward mode, also where torch records nothing for backward, and `torch.func.vjp`."""
    mesh, (vertices, _) = scene(kind)
    camera = nr.Camera.look_at(torch.tensor([[0.3, 0.8, -2.2]]))
    random = torch.Generator().manual_seed(1)
    motion, pull = torch.randn(vertices.shape, generator=random), torch.randn(5, *SIZE, generator=random)

    def changes(tile):
        def draw(moved):
            images = nr.render(mesh.replace(vertices=moved), camera, SIZE, outputs=("rgb", "alpha", "depth"), tile=tile)
            return torch.cat((images.rgb[0], images.alpha, images.depth))

        with torch.set_grad_enabled(recorded):
            pushed = torch.func.jvp(draw, (vertices.detach(),), (motion,))[1]
        return pushed, torch.func.vjp(draw, vertices.detach())[1](pull)[0]

    for whole, strips in zip(changes(None), changes(32), strict=True):
        assert (strips - whole).norm() < ROUNDING * whole.norm()


def test_what_strips_cannot_do():
    mesh, _ = scene("image")
    camera = nr.Camera.look_at((0.0, 0.0, -2.7))
    with pytest.raises(ValueError, match="tile: expected None with the gradient 'nmr'"):
        nr.render(mesh, camera, 64, tile=32, gradient="nmr")
    with torch.no_grad():
        assert torch.equal(*(nr.render(mesh, camera, 64, tile=tile, gradient="nmr").rgb for tile in (None, 32)))
    for options, sentence in [({"tile": 8}, "at least 16"), ({"tile": 32, "layers": 2}, "None with layers")]:
        with pytest.raises(ValueError, match=f"tile: expected .*{sentence}"):
            nr.render(mesh, camera, 64, **options)


@pytest.mark.parametrize("channels", [(), (3,), (4,)])
def test_png_of_strips(tmp_path, channels):
    pixels = np.random.default_rng(0).integers(0, 256, (37, 20, *channels), np.uint8)
    save_png_strips(tmp_path / "a.png", [pixels[:9], pixels[9:10], pixels[10:]], 37, 20)
    assert np.array_equal(np.asarray(Image.open(tmp_path / "a.png")), pixels)
    for wrong in ([pixels[:9]], [pixels[:, :7]], [pixels, pixels], []):
        with pytest.raises(ValueError, match="strips: expected"):
            save_png_strips(tmp_path / "b.png", wrong, 37, 20)
    assert not (tmp_path / "b.png").exists()
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(encode_png(pixels)))), pixels)


def test_png_of_sixteen_bits():
    pixels = np.random.default_rng(0).integers(0, 1 << 16, (7, 5), np.uint16)
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(encode_png(pixels)))), pixels)


@pytest.mark.parametrize("options", [[], ["--background", "transparent"], ["--mode", "silhouettes"]])
def test_command_streams_large_pictures(tmp_path, monkeypatch, options):
    nr.Mesh.icosphere(2).save(tmp_path / "ball.ply")
    call = ["render", str(tmp_path / "ball.ply"), *options, "--size", "70", "--output"]
    from neural_renderer.apps.command_line import main

    assert main([*call, str(tmp_path / "whole.png")]) == 0
    for name in ("_LARGE", "_TILE"):
        monkeypatch.setattr(command, name, 20)
    assert main([*call, str(tmp_path / "strips.png")]) == 0
    whole, strips = (np.asarray(Image.open(tmp_path / name)) for name in ("whole.png", "strips.png"))
    assert np.array_equal(whole, strips)


@pytest.mark.parametrize(("eye", "up"), [((0.0, 0.5, -4.0), 0.0), ((0.3, 0.2, -0.4), 0.0), ((0.0, 0.0, -4.0), 7.0)])
@torch.no_grad()
def test_rows_with_the_mesh(eye, up):
    """Seen from afar, from inside, and not at all: the rows are those of the whole image, the others show nothing."""
    mesh = nr.Mesh.icosphere()
    camera = nr.Camera.look_at(eye, (0.0, up, 0.0), viewing_angle=30)
    drawn, rows = render_rows(mesh, camera, SIZE, outputs=OUTPUTS)
    whole = nr.render(mesh, camera, SIZE, background=0.0, outputs=OUTPUTS)
    for name in OUTPUTS:
        assert torch.equal(getattr(drawn, name), getattr(whole, name)[..., rows, :]), name
    whole.alpha[..., rows, :] = 0
    assert not whole.alpha.any()
    assert (rows == slice(0, SIZE[0])) == (eye[2] == -0.4)
