"""The modern form, `render`: pictures are not mirrored, light falls from where it comes, gradients reach everything."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr
from tests.rounding import EPS, rounding


def white_sphere(device, level=2, radius=0.5):
    return nr.Mesh.icosphere(level, radius, texture_size=2).to(device)


def cube_at(x, y, z, device, size=0.4):
    vertices, faces = nr.cube(size)
    textures = torch.ones(len(faces), 2, 2, 2, 3, device=device)
    return (vertices.to(device) + torch.tensor([x, y, z], device=device), faces.to(device), textures)


def cameras(device):
    """Cameras at +z that look at the origin, made in three ways, and a mirrored one at -z."""
    turn = torch.diag(torch.tensor([1.0, -1, -1], device=device))  # OpenCV's y is down and its z is ahead
    K = torch.tensor([[1.7, 0, 1], [0, 1.7, 1], [0, 0, 1]], device=device)
    t = torch.tensor([0.0, 0, 3], device=device)
    return {
        "look_at": nr.Camera.look_at((0, 0, 3)),
        "look": nr.Camera.look((0, 0, 3), (0, 0, -1)),
        "orthographic": nr.Camera.look_at((0, 0, 3), orthographic=True),
        "projection": nr.Camera.projection(K, turn, t, orig_size=2),
    }


def centre(image):
    """Column and row, counted from the middle to the right and up, of the centre of an alpha image [1, H, W]."""
    _, height, width = image.shape
    x = torch.arange(width, device=image.device) - (width - 1) / 2
    y = (height - 1) / 2 - torch.arange(height, device=image.device)
    return float((image[0].sum(0) * x).sum() / image.sum()), float((image[0].sum(1) * y).sum() / image.sum())


@pytest.mark.parametrize("name", ["look_at", "look", "orthographic", "projection"])
def test_pictures_are_not_mirrored(device, name):
    """From +z, in a right-handed world with y up, +x is to the right and +y is up."""
    camera = cameras(device)[name]
    for x, y in ((0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5), (0.5, 0.25)):
        column, row = centre(nr.render(cube_at(x, y, 0, device), camera, 64).alpha)
        assert abs(column / 64 - x * row / y / 64) < 0.05 if y else abs(row) < 1
        assert (column > 5) == (x > 0) and (column < -5) == (x < 0)
        assert (row > 2) == (y > 0) and (row < -2) == (y < 0)


def test_mirrored_is_the_mirror_image(device):
    mesh = cube_at(0.5, 0.2, 0.1, device)
    # Light along the mirror's plane, so that it is the same in both.
    light = nr.Light(direction=(0, 0.6, 0.8))
    plain, mirrored = (
        nr.render(mesh, nr.Camera.look_at((0, 0, 3), mirrored=m), 48, light=light) for m in (False, True)
    )
    for name, one, other in zip(("rgb", "alpha", "depth"), plain, mirrored, strict=True):
        wrong = (one - other.flip(-1)).abs() > 1e-3
        assert wrong.float().mean() < 0.005, name


def test_is_the_old_renderer_through_mirrored_cameras(device):
    mesh = white_sphere(device)
    eye = nr.get_points_from_angles(2.7, 20, 50)
    renderer = nr.Renderer(32, camera_mode="look_at", light_direction=[0.6, 0.8, 0])
    renderer.eye = eye
    old = renderer(mesh.vertices[None], mesh.faces, mesh.textures[None])
    light = nr.Light(direction=(0.6, 0.8, 0))
    new = nr.render(mesh, nr.Camera.look_at(eye, mirrored=True), 32, light=light)
    for a, b in zip(old, (new.rgb, new.depth, new.alpha), strict=True):
        torch.testing.assert_close(
            a, b, **rounding(16, float(b.detach().abs().max()))
        )  # axes and light, worked out twice


@pytest.mark.parametrize("name", ["look_at", "look", "orthographic", "projection", "mirrored"])
@pytest.mark.parametrize("direction", [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])
@pytest.mark.parametrize("two_sided", [True, False])
def test_light_brightens_the_side_it_comes_from(device, name, direction, two_sided):
    camera = nr.Camera.look_at((0, 0, 3), mirrored=True) if name == "mirrored" else cameras(device)[name]
    mesh = white_sphere(device)
    if not two_sided and name == "mirrored":
        # Faces that run counter-clockwise in the world run clockwise in a mirror.
        mesh = nr.Mesh(mesh.vertices, mesh.faces.flip(1), mesh.textures)
    images = nr.render(mesh, camera, 64, light=nr.Light(0.2, 0.8, direction=direction), two_sided=two_sided)
    bright = images.rgb[:, 0] - 0.2 * images.alpha
    if direction[2]:
        assert (bright.mean() > 0.02) == (direction[2] > 0)
        assert (bright.abs().max() < 1e-5) == (direction[2] < 0)
        return
    column, row = centre(bright.clamp(min=0))
    right = -direction[0] if name == "mirrored" else direction[0]
    assert column * right > 3 if right else abs(column) < 1
    assert row * direction[1] > 3 if direction[1] else abs(row) < 1


def test_light_none_shows_the_textures(device):
    mesh = white_sphere(device)
    images = nr.render(mesh, nr.Camera.look_at((0, 0, 3)), 32, light=None)
    torch.testing.assert_close(images.rgb, images.alpha[:, None].expand(1, 3, 32, 32))


@pytest.mark.parametrize("size", [(24, 48), (48, 24), (33, 20)])
def test_pixels_stay_square(device, size):
    """The height spans the field of view; the width follows the aspect."""
    for camera in (nr.Camera.look_at((0, 0, 3)), nr.Camera.look_at((0, 0, 3), orthographic=True)):
        tall = nr.render(white_sphere(device, 3, 0.35), camera, size, anti_aliasing=False).alpha
        square = nr.render(white_sphere(device, 3, 0.35), camera, size[0], anti_aliasing=False).alpha
        assert tall.shape == (1, *size)
        assert abs(tall.sum() / square.sum() - 1) < 0.03
        assert abs(int(tall[0].any(0).sum()) - int(tall[0].any(1).sum())) <= 1


def test_orthographic_size_and_depth(device):
    camera = nr.Camera.look_at((0, 0, 5), orthographic=True, scale=0.5)
    images = nr.render(cube_at(0, 0, 0, device, 1.0), camera, 64, anti_aliasing=False)
    assert int(images.alpha.sum()) == 16**2
    torch.testing.assert_close(images.depth[images.alpha > 0], torch.full((256,), 4.5, device=device))


def test_one_mesh_many_cameras_and_many_meshes_one_camera(device):
    mesh = white_sphere(device)
    eyes = nr.get_points_from_angles(3.0, 20.0, torch.tensor([0.0, 120, 240], device=device))
    views = nr.render(mesh, nr.Camera.look_at(eyes), 24)
    assert views.rgb.shape == (3, 3, 24, 24)
    for b in range(3):
        alone = nr.render(mesh, nr.Camera.look_at(eyes[b]), 24)
        # A vertex may differ by a rounding; a pixel's depth mixes the faces' depth with the background's, 100.
        torch.testing.assert_close(views.depth[b], alone.depth[0], **rounding(64, 100))
    vertices = torch.stack([mesh.vertices * s for s in (0.5, 1.0, 1.5)])
    many = nr.render((vertices, mesh.faces, mesh.textures), nr.Camera.look_at((0, 0, 3)), 24)
    assert many.alpha.shape == (3, 24, 24) and (many.alpha.sum((1, 2)).diff() > 0).all()


def test_outputs_and_plain_meshes(device):
    mesh = white_sphere(device)
    camera = nr.Camera.look_at((0, 0, 3))
    images = nr.render((mesh.vertices, mesh.faces), camera, 24, outputs=("alpha", "depth"))
    rgb, alpha, depth = images
    assert rgb is None and alpha is images.alpha and depth is images.depth
    assert torch.equal(alpha, nr.render(mesh, camera, 24).alpha)
    with pytest.raises(AttributeError, match=r'rgb: expected an output .*, got images of alpha, depth; add "rgb"'):
        _ = images.rgb
    white = nr.Mesh(mesh.vertices, mesh.faces)
    for plain, drawn in zip(
        nr.render((mesh.vertices, mesh.faces), camera, 24), nr.render(white, camera, 24), strict=True
    ):
        torch.testing.assert_close(plain, drawn, **rounding(16))


@pytest.mark.parametrize("name", ["look_at", "orthographic", "projection"])
def test_vertices_are_checked_once(device, name, monkeypatch):
    checked = []
    mesh, camera = white_sphere(device), cameras(device)[name]
    monkeypatch.setattr(nr.base.validate, "finite", lambda name, value: checked.append(name) or 0.0)
    nr.render(mesh, camera, 16)
    assert checked.count("vertices") == 1 and checked.count("faces") == 1  # the latter on the screen


def test_gradients_reach_everything(device):
    mesh = white_sphere(device)
    random = torch.Generator().manual_seed(0)

    def leaf(*values):
        return torch.tensor(values, device=device).squeeze().requires_grad_()

    eye, angle = leaf(0.3, 0.5, 3.0), leaf(30.0)
    light = nr.Light(leaf(0.4), leaf(0.6), leaf(0.9, 0.8, 0.7), leaf(0.7, 0.8, 0.9), leaf(0.3, 0.8, 0.5))
    background = torch.rand(3, 24, 30, device=device, requires_grad=True)
    vertices, textures = (p.detach().clone().requires_grad_() for p in (mesh.vertices, mesh.textures))
    camera = nr.Camera.look_at(eye, viewing_angle=angle)
    images = nr.render((vertices, mesh.faces, textures), camera, (24, 30), light=light, background=background)
    sum((image * torch.randn(image.shape, generator=random).to(device)).sum() for image in images).backward()
    lights = [light.ambient, light.directional, light.ambient_color, light.directional_color, light.direction]
    for n, tensor in enumerate([eye, angle, *lights, background, vertices, textures]):
        assert tensor.grad is not None and tensor.grad.isfinite().all() and tensor.grad.any(), n


def test_depth_gradient_moves_the_camera_the_right_way(device):
    """Away from the sphere each seen pixel's depth grows by the distance."""
    mesh = white_sphere(device, 3)
    eye = torch.tensor([0.0, 0, 3], device=device, requires_grad=True)
    images = nr.render(mesh, nr.Camera.look_at(eye, orthographic=True), 32, outputs=("alpha", "depth"))
    covered = images.alpha.detach() == 1
    images.depth[covered].sum().backward()
    assert float(eye.grad[2]) == pytest.approx(float(covered.sum()), rel=2 * 32**2 * EPS)  # a sum over pixels


def test_a_camera_inside_the_mesh_sees_it_all_around(device):
    """Faces behind and across the camera's plane draw nothing wrong: no hole, and each depth on the sphere."""
    mesh = white_sphere(device, 3, 2.0)
    images = nr.render(mesh, nr.Camera.look_at((0, 0.3, 0.5), viewing_angle=60), 32, anti_aliasing=False)
    assert (images.alpha == 1).all() and (images.depth > 0.3).all() and (images.depth < 2.6).all()


def test_wrong_arguments():
    mesh = nr.Mesh.icosphere(0)
    camera = nr.Camera.look_at((0, 0, 3))
    for arguments, error, word in (
        (("mesh", camera), TypeError, "mesh"),
        ((mesh, (0, 0, 3)), TypeError, "camera"),
        ((mesh, camera, 0), ValueError, "size"),
        ((mesh, nr.Camera.look_at(torch.rand(3, 3)), (4,)), ValueError, "size"),
    ):
        with pytest.raises(error, match=f"^{word}: expected"):
            nr.render(*arguments)
    with pytest.raises(TypeError, match=r"^textures: expected a floating-point torch tensor, got"):
        nr.render((mesh.vertices, mesh.faces, "red"), camera, 8)
    with pytest.raises(ValueError, match=r"^textures: expected shape \[B, F, T, T, T, 3\], got \[3\]"):
        nr.render((mesh.vertices, mesh.faces, torch.ones(3)), camera, 8)
    with pytest.raises(ValueError, match=r"^vertices on the screen, in float32: expected finite numbers, got"):
        nr.render((mesh.vertices.double() * 1e39, mesh.faces), nr.Camera.look_at((0, 0, 3)), 8, outputs="alpha")
    with pytest.raises(TypeError, match=r"^light: expected"):
        nr.render(mesh, camera, light=(0, 1, 0))
    with pytest.raises(ValueError, match="batch"):
        nr.render(
            (torch.rand(2, 9, 3), torch.zeros(1, 3, dtype=torch.int32)), nr.Camera.look_at(torch.rand(3, 3) + 1), 8
        )


def test_plain_tensors_compile_in_one_graph():
    vertices, faces = nr.icosphere(1)
    camera = nr.Camera.look_at((0.3, 1.0, 2.5), viewing_angle=25)

    def draw(points):
        return nr.render((points, faces), camera, 16, outputs="alpha").alpha

    found = []
    for function in (draw, torch.compile(draw, fullgraph=True, backend="eager")):
        points = vertices.clone().requires_grad_()
        alpha = function(points)
        found.append((alpha.detach(), *torch.autograd.grad(alpha.sum(), points)))
    assert torch.equal(found[0][0], found[1][0])
    torch.testing.assert_close(found[1][1], found[0][1], **rounding(16 * 16, float(found[0][1].abs().max())))
