"""`Renderer`: attributes, modes and cameras; arguments stay unchanged."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import neural_renderer as nr
from tests.rounding import EPS, rounding

DEFAULTS = {
    "image_size": 256,
    "anti_aliasing": True,
    "background_color": [0, 0, 0],
    "fill_back": True,
    "camera_mode": "projection",
    "K": None,
    "R": None,
    "t": None,
    "orig_size": 1024,
    "perspective": True,
    "viewing_angle": 30,
    "camera_direction": [0, 0, 1],
    "near": 0.1,
    "far": 100,
    "light_intensity_ambient": 0.5,
    "light_intensity_directional": 0.5,
    "light_color_ambient": [1, 1, 1],
    "light_color_directional": [1, 1, 1],
    "light_direction": [0, 1, 0],
    "camera_up": [0, 1, 0],
}


def sphere(device, batch=1, level=2, radius=0.5):
    vertices, faces = (t.to(device) for t in nr.icosphere(level, radius))
    textures = torch.ones(batch, len(faces), 2, 2, 2, 3, device=device)
    return vertices.expand(batch, -1, -1).clone(), faces.expand(batch, -1, -1), textures


def calibrated(device, batch=1, size=64):
    K = torch.tensor([[size, 0, size / 2], [0, size, size / 2], [0, 0, 1.0]], device=device).expand(batch, 3, 3)
    R = torch.eye(3, device=device).expand(batch, 3, 3)
    t = torch.tensor([[0.0, 0, 2.5]], device=device).expand(batch, 1, 3)
    return {"K": K, "R": R, "t": t, "orig_size": size}


def test_defaults():
    renderer = nr.Renderer()
    assert {name: getattr(renderer, name) for name in DEFAULTS} == DEFAULTS
    assert renderer.rasterizer_eps == 1e-3 and torch.equal(renderer.dist_coeffs, torch.zeros(1, 5))
    assert renderer.eye[:2] == [0, 0] and renderer.eye[2] == pytest.approx(-2.7320508)
    assert nr.Renderer(viewing_angle=45).eye[2] == pytest.approx(-2)
    assert isinstance(renderer, torch.nn.Module) and not list(renderer.parameters())


@pytest.mark.parametrize("name", DEFAULTS)
def test_constructor_arguments_are_attributes(name):
    given = {"camera_mode": "look", "viewing_angle": 20, "image_size": (3, 4)}.get(name, [0.25, 0.5, 0.75])
    found = getattr(nr.Renderer(**{name: given}), name)
    assert (found.tolist() if isinstance(found, torch.Tensor) else found) == given


def test_calibrations_are_tensors_at_once(device):
    """Programs take them from the renderer, move and multiply them; a tensor stays the one that was given."""
    vertices, faces, _ = sphere(device)
    camera = calibrated(device)
    arrays = {name: value.double().cpu().numpy() for name, value in camera.items() if name != "orig_size"}
    lists = {name: value.tolist() for name, value in arrays.items()}
    kept = nr.Renderer(32, **camera)
    assert all(getattr(kept, name) is camera[name] for name in arrays)
    for given in (arrays, lists):
        renderer = nr.Renderer(32, **given, orig_size=camera["orig_size"], dist_coeffs=np.zeros((1, 5)))
        for name in (*arrays, "dist_coeffs"):
            value = getattr(renderer, name)
            assert isinstance(value, torch.Tensor) and value.dtype == torch.float32
            setattr(renderer, name, value.to(device))
        for one, other in zip(*(r(vertices, faces, mode="depth") for r in (renderer, kept)), strict=True):
            assert torch.equal(one, other)
    assert nr.Renderer(**{**camera, "dist_coeffs": None}).dist_coeffs.to(device).shape == (1, 5)
    with pytest.raises(TypeError, match="K: expected numbers"):
        nr.Renderer(K=["a"])


def test_viewing_angle_counts_only_where_it_is_used(device):
    vertices, faces, _ = sphere(device)
    for angle in (0, 90, 120):
        nr.Renderer(16, viewing_angle=angle, **calibrated(device))(vertices, faces, mode="silhouettes")
    flat = nr.Renderer(16, camera_mode="look_at", viewing_angle=90, perspective=False)
    assert flat(vertices, faces, mode="silhouettes").any()
    later = nr.Renderer(16, viewing_angle=0)
    later.camera_mode, later.eye = "look_at", [0, 0, -2.7]
    with pytest.raises(ValueError, match="viewing_angle: expected degrees"):
        later(vertices, faces, mode="silhouettes")


@pytest.mark.parametrize("mode", ["look_at", "look"])
def test_camera_up(device, mode):
    vertices, faces, _ = sphere(device)
    vertices = vertices * torch.tensor([1.0, 0.5, 0.3], device=device)
    renderer = nr.Renderer(32, camera_mode=mode, anti_aliasing=False)
    upright = renderer(vertices, faces, mode="silhouettes")
    renderer.camera_up = torch.tensor([1.0, 0, 0], device=device)
    on_its_side = renderer(vertices, faces, mode="silhouettes")
    assert not torch.equal(upright, on_its_side) and torch.equal(on_its_side, upright.transpose(1, 2))
    given = nr.Renderer(32, camera_mode=mode, anti_aliasing=False, camera_up=(1, 0, 0))
    assert torch.equal(given(vertices, faces, mode="silhouettes"), on_its_side)


def test_height_and_width(device):
    vertices, faces, textures = sphere(device)
    renderer = nr.Renderer(camera_mode="look_at", image_height=10, image_width=16, background_color=0.25)
    assert renderer.image_size == (10, 16)
    rgb = renderer(vertices, faces, textures)[0]
    assert rgb.shape == (1, 3, 10, 16) and (rgb[..., 0] == 0.25).all()
    renderer.image_width = 20
    assert renderer(vertices, faces, mode="depth").shape == (1, 10, 20)
    assert nr.Renderer(64, image_width=32).image_size == (64, 32) and nr.Renderer((3, 4)).image_height == 3


def test_renderers_share_no_lists():
    one, other = nr.Renderer(), nr.Renderer()
    one.background_color[0] = 1
    one.light_direction[0] = one.camera_direction[0] = 5
    assert (other.background_color, other.light_direction, other.camera_direction) == ([0, 0, 0], [0, 1, 0], [0, 0, 1])


@pytest.mark.parametrize("mode", ["look_at", "look", "projection", "none"])
def test_modes_are_the_same_pictures(device, mode):
    vertices, faces, textures = sphere(device, 2)
    if mode == "none":
        vertices = vertices + torch.tensor([0, 0, 2.0], device=device)
    renderer = nr.Renderer(32, camera_mode=mode, **calibrated(device, 2))
    rgb, depth, alpha = renderer(vertices, faces, textures)
    assert (rgb.shape, depth.shape, alpha.shape) == ((2, 3, 32, 32), (2, 32, 32), (2, 32, 32))
    assert 0.02 < alpha.mean() < 0.9 and (depth.amin((1, 2)) > 0.5).all() and (depth[alpha == 0] == 100).all()
    assert torch.equal(renderer(vertices, faces, textures, mode="rgb"), rgb)
    assert torch.equal(renderer(vertices, faces, mode="silhouettes"), alpha)
    assert torch.equal(renderer(vertices, faces, mode="depth"), depth)
    assert torch.equal(renderer.render_rgb(vertices, faces, textures), rgb)
    assert torch.equal(renderer.render_silhouettes(vertices, faces), alpha)
    assert torch.equal(renderer.render_depth(vertices, faces), depth)
    assert all(
        torch.equal(a, b) for a, b in zip(renderer.render(vertices, faces, textures), (rgb, depth, alpha), strict=True)
    )
    with pytest.raises(ValueError, match=r"mode: .*'normals'"):
        renderer(vertices, faces, textures, mode="normals")


@pytest.mark.parametrize("mode", ["look_at", "look", "projection", "none"])
def test_vertices_are_checked_once(device, mode, monkeypatch):
    checked = []
    monkeypatch.setattr(nr.base.validate, "finite", lambda name, value: checked.append((name, value.shape)) or 0.0)
    vertices, faces, textures = sphere(device)
    nr.Renderer(16, camera_mode=mode, **calibrated(device))(vertices, faces, textures)
    assert checked.count(("vertices", vertices.shape)) == 1
    assert [name for name, _ in checked].count("faces") == 1  # their corners on the screen


def test_without_a_camera_matrix_it_says_so(device):
    vertices, faces, textures = sphere(device)
    renderer = nr.Renderer(16)
    with pytest.raises(ValueError, match=r"K: .*camera_mode"):
        renderer(vertices, faces, textures)
    camera = calibrated(device)
    for name in ("K", "R", "t"):
        with pytest.raises(ValueError, match=f"^{name}: "):
            renderer(vertices, faces, mode="silhouettes", **{**camera, name: None})
    renderer.camera_mode = "look_at"
    assert renderer(vertices, faces, mode="silhouettes").any()


def test_camera_of_the_call_replaces_that_of_the_constructor(device):
    vertices, faces, _ = sphere(device)
    camera = calibrated(device)
    wrong = {"K": camera["K"] * 2, "R": -camera["R"], "t": camera["t"] * 3, "orig_size": 7}
    expected = nr.Renderer(32, **camera)(vertices, faces, mode="silhouettes")
    assert torch.equal(nr.Renderer(32, **wrong)(vertices, faces, mode="silhouettes", **camera), expected)
    renderer = nr.Renderer(32)
    for name, value in camera.items():
        setattr(renderer, name, value)
    assert torch.equal(renderer(vertices, faces, mode="silhouettes"), expected) and expected.any()


def test_changed_attributes_take_effect(device):
    vertices, faces, textures = sphere(device)
    renderer = nr.Renderer(32, camera_mode="look_at")
    plain = renderer(vertices, faces, textures)[0]
    changes = {
        "image_size": 16,
        "anti_aliasing": False,
        "background_color": [1, 0, 0],
        "eye": [0, 0, -5],
        "viewing_angle": 20,
        "perspective": False,
        "light_intensity_ambient": 0.1,
        "light_intensity_directional": 0.1,
        "light_color_ambient": [1, 0, 0],
        "light_color_directional": [1, 0, 0],
        "light_direction": [1, 0, 0],
        "near": 3.0,
        "far": 2.0,
        "fill_back": False,
    }
    for name, value in changes.items():
        renderer = nr.Renderer(32, camera_mode="look_at")
        setattr(renderer, name, value)
        image = renderer(vertices, faces, textures)[0]
        assert image.shape != plain.shape or not torch.equal(image, plain), name
    renderer = nr.Renderer(32, camera_mode="look", camera_direction=[0.3, 0, 1])
    moved = renderer(vertices, faces, mode="silhouettes")
    renderer.camera_direction = [0, 0, 1]
    assert not torch.equal(renderer(vertices, faces, mode="silhouettes"), moved)


@pytest.mark.parametrize(
    ("name", "value"), [("camera_mode", None), ("perspective", "no"), ("fill_back", None), ("viewing_angle", "wide")]
)
def test_attributes_are_checked_when_drawing(device, name, value):
    vertices, faces, _ = sphere(device)
    renderer = nr.Renderer(8, camera_mode="look_at")
    setattr(renderer, name, value)
    with pytest.raises(TypeError, match=f"^{name}: expected .*got"):
        renderer(vertices, faces, mode="silhouettes")


def test_each_view_may_have_its_angle(device):
    vertices, faces, _ = sphere(device, 2)
    angles = torch.tensor([20.0, 40.0], device=device, requires_grad=True)
    both = nr.Renderer(16, camera_mode="look_at", viewing_angle=angles)
    images = both(vertices, faces, mode="silhouettes")
    for index, angle in enumerate((20.0, 40.0)):
        one = nr.Renderer(16, camera_mode="look_at", viewing_angle=angle)
        assert both.eye[index].tolist() == pytest.approx(one.eye, rel=16 * EPS)  # the one float32, the other Python's
        # A sample whose centre is within a rounding of an edge may change sides.
        alone = one(vertices[:1], faces[:1], mode="silhouettes")[0]
        assert (images[index] - alone).abs().sum() <= 0.5
    for _ in range(2):  # no graph is left in the renderer
        both(vertices, faces, mode="silhouettes").sum().backward()
    assert (angles.grad != 0).all()
    for wrong in (0, 90, torch.tensor([30.0, 95.0])):
        with pytest.raises(ValueError, match=r"^viewing_angle: expected degrees in \(0, 90\)"):
            nr.Renderer(camera_mode="look_at", viewing_angle=wrong)


def test_camera_direction_of_the_constructor(device):
    """The port ignored it."""
    vertices, faces, _ = sphere(device)
    away = nr.Renderer(32, camera_mode="look", camera_direction=[0, 0, -1])
    assert not away(vertices, faces, mode="silhouettes").any()
    back = nr.Renderer(32, camera_mode="look", camera_direction=[0, 0, -1])
    back.eye = [0, 0, 2.7]
    assert back(vertices, faces, mode="silhouettes").any()


def test_fill_back(device):
    """Without it the mirroring camera shows the far inside of the sphere: measured on the first packages."""
    vertices, faces, _ = sphere(device, level=4)
    renderer = nr.Renderer(33, camera_mode="look_at", anti_aliasing=False)
    assert float(renderer(vertices, faces, mode="depth")[0, 16, 16]) == pytest.approx(2.732 - 0.5, abs=5e-3)
    renderer.fill_back = False
    assert float(renderer(vertices, faces, mode="depth")[0, 16, 16]) == pytest.approx(2.732 + 0.5, abs=5e-3)
    renderer = nr.Renderer(33, fill_back=False, anti_aliasing=False, **calibrated(device))
    assert float(renderer(vertices, faces, mode="depth")[0, 16, 16]) == pytest.approx(2.0, abs=5e-3)


def test_near_and_far(device):
    vertices, faces, textures = sphere(device)
    renderer = nr.Renderer(32, camera_mode="look_at", anti_aliasing=False)
    renderer.far = 2.5
    depth = renderer(vertices, faces, textures)[1]
    assert (depth[depth < 2.5] > 2.2).all() and (depth == 2.5).any()


def test_textures_are_never_changed(device):
    """The port multiplied them in place: darker at each call, and an error where they required a gradient."""
    vertices, faces, textures = sphere(device)
    textures.requires_grad_()
    for fill_back in (False, True):
        for mode in ("look_at", "projection"):
            renderer = nr.Renderer(16, camera_mode=mode, fill_back=fill_back, **calibrated(device))
            images = [renderer(vertices, faces, textures)[0] for _ in range(3)]
            assert torch.equal(images[0], images[1]) and torch.equal(images[0], images[2])
            images[0].sum().backward()
    assert (textures == 1).all() and textures.grad.any()
    assert (vertices == sphere(device)[0]).all()


@pytest.mark.parametrize("batch", [1, 2, 3, 4])
def test_a_batch_is_its_views_one_by_one(device, batch):
    """Three was the batch in which the port's cross products mixed up views and axes."""
    vertices, faces, textures = sphere(device, batch)
    vertices = vertices * torch.linspace(0.5, 1, batch, device=device)[:, None, None]
    eyes = torch.tensor(nr.get_points_from_angles(2.7, 30, 0), device=device) + torch.rand(batch, 3, device=device) / 2
    colors = torch.rand(batch, 3, device=device)
    for mode in ("look_at", "look"):
        renderer = nr.Renderer(24, camera_mode=mode, background_color=colors)
        renderer.eye = eyes
        together = renderer(vertices, faces, textures)
        assert together[2].flatten(1).any(1).all() or mode == "look"
        for b in range(batch):
            renderer.eye, renderer.background_color = eyes[b], colors[b]
            alone = renderer(*(t[b : b + 1] for t in (vertices, faces, textures)))
            for whole, part in zip(together, alone, strict=True):
                torch.testing.assert_close(whole[b], part[0], **rounding(64, 100))  # depth is up to 100


def test_faces_shared_and_of_both_integer_types(device):
    vertices, faces, textures = sphere(device, 2)
    renderer = nr.Renderer(24, camera_mode="look_at")
    expected = renderer(vertices, faces, textures)
    for other in (faces[0], faces.long(), faces[0].long(), faces[:1]):
        assert all(torch.equal(a, b) for a, b in zip(renderer(vertices, other, textures), expected, strict=True))


def test_non_square_images(device):
    """The screen [-1, 1]² fills the image whatever its sides; every third row is the square image's."""
    vertices, faces, _ = sphere(device)
    square = nr.Renderer(30, camera_mode="look_at", anti_aliasing=False)(vertices, faces, mode="silhouettes")
    flat = nr.Renderer((10, 30), camera_mode="look_at", anti_aliasing=False)(vertices, faces, mode="silhouettes")
    assert flat.shape == (1, 10, 30) and (flat != square[:, 1::3]).sum() <= 2


def test_gradients_reach_all_parameters(device):
    vertices, faces, textures = sphere(device)
    renderer = nr.Renderer(24, camera_mode="look")
    leaves = {
        "eye": torch.tensor([0.1, 0.2, -2.7]),
        "camera_direction": torch.tensor([0.0, 0.05, 1]),
        "viewing_angle": torch.tensor(30.0),
        "light_intensity_ambient": torch.tensor(0.4),
        "light_intensity_directional": torch.tensor(0.6),
        "light_color_ambient": torch.tensor([0.9, 0.8, 0.7]),
        "light_color_directional": torch.tensor([0.7, 0.8, 0.9]),
        "light_direction": torch.tensor([0.3, 0.8, -0.5]),
        "background_color": torch.tensor([0.1, 0.2, 0.3]),
    }
    leaves = {name: value.to(device).requires_grad_() for name, value in leaves.items()}
    for name, value in leaves.items():
        setattr(renderer, name, value)
    vertices.requires_grad_(), textures.requires_grad_()
    random = torch.Generator().manual_seed(0)
    images = renderer(vertices, faces, textures)
    sum((image * torch.randn(image.shape, generator=random).to(device)).sum() for image in images).backward()
    for name, leaf in {**leaves, "vertices": vertices, "textures": textures}.items():
        assert leaf.grad.isfinite().all() and leaf.grad.any(), name


def test_can_be_saved_and_copied(tmp_path, device):
    import copy

    vertices, faces, _ = sphere(device)
    renderer = nr.Renderer(16, camera_mode="look_at", viewing_angle=20)
    torch.save(renderer, tmp_path / "renderer.pt")
    for other in (
        copy.deepcopy(renderer),
        torch.load(tmp_path / "renderer.pt", weights_only=False),
        renderer.to(device),
    ):
        assert torch.equal(other(vertices, faces, mode="depth"), renderer(vertices, faces, mode="depth"))


def test_a_number_takes_the_place_of_a_parameter():
    renderer = nr.Renderer(camera_mode="look_at")
    renderer.eye = torch.nn.Parameter(torch.tensor([0.0, 0.0, -3.0]))
    assert len(list(renderer.parameters())) == 1
    renderer.eye = (0, 0, -2.7)
    assert renderer.eye == (0, 0, -2.7) and not list(renderer.parameters())


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("light_intensity_ambient", "bright"),
        ("light_color_directional", (1.0,)),
        ("light_direction", (0.0, float("nan"), 0.0)),
        ("background_color", [0, 0]),
        ("rasterizer_eps", -1.0),
        ("fill_back", torch.tensor([1, 0])),
        ("gradient", np.array(["nmr", "edge"])),
    ],
)
def test_messages_name_the_attribute(name, value):
    mesh, renderer = nr.Mesh.icosphere(1), nr.Renderer(camera_mode="look_at", image_size=16)
    setattr(renderer, name, value)
    with pytest.raises((TypeError, ValueError), match=f"^{name}: expected"):
        renderer(*mesh.get_batch(1))


def test_forward_mode_is_an_error():
    """torch would take the operators' tangents for zero."""
    mesh, renderer = nr.Mesh.icosphere(1), nr.Renderer(camera_mode="look_at", image_size=16)
    vertices = mesh.vertices.detach()[None]
    with pytest.raises(RuntimeError, match="forward mode"):
        torch.func.jvp(lambda v: renderer(v, mesh.faces[None], mode="silhouettes"), (vertices,), (vertices,))
