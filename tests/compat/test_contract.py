"""Promises of docs/compatibility.md to code written for the first packages, call by call, in tables."""

from __future__ import annotations

import copy
import importlib
import inspect
import pickle

import numpy as np
import pytest
import torch

import neural_renderer as nr
from neural_renderer.base.constants import old_device
from tests.paths import ROOT

CAMERA = "K=None R=None t=None dist_coeffs=None orig_size=None"
RASTER = "image_size=256 anti_aliasing=True near=0.1 far=100 eps=0.0001"
SIGNATURES = {
    "Renderer": "image_size=256 anti_aliasing=True background_color=(0, 0, 0) fill_back=True camera_mode='projection' "
    "K=None R=None t=None dist_coeffs=None orig_size=1024 perspective=True viewing_angle=30 camera_direction=(0, 0, 1) "
    "near=0.1 far=100 light_intensity_ambient=0.5 light_intensity_directional=0.5 light_color_ambient=(1, 1, 1) "
    "light_color_directional=(1, 1, 1) light_direction=(0, 1, 0)",
    "Renderer.forward": f"vertices faces textures=None mode=None {CAMERA}",
    "Renderer.render": f"vertices faces textures {CAMERA}",
    "Renderer.render_rgb": f"vertices faces textures {CAMERA}",
    "Renderer.render_silhouettes": f"vertices faces {CAMERA}",
    "Renderer.render_depth": f"vertices faces {CAMERA}",
    "Rasterize": "image_size near far eps background_color return_rgb=False return_alpha=False return_depth=False",
    "rasterize_rgbad": f"faces textures=None {RASTER} background_color=(0, 0, 0) return_rgb=True return_alpha=True "
    "return_depth=True",
    "rasterize": f"faces textures=None {RASTER} background_color=(0, 0, 0)",
    "rasterize_silhouettes": f"faces {RASTER}",
    "rasterize_depth": f"faces {RASTER}",
    "look_at": "vertices eye at=None up=None",
    "look": "vertices eye direction=None up=None",
    "perspective": "vertices angle=30.0",
    "projection": "vertices K R t dist_coeffs=None orig_size=1024 eps=1e-09",
    "lighting": "faces textures intensity_ambient=0.5 intensity_directional=0.5 color_ambient=(1.0, 1.0, 1.0) "
    "color_directional=(1.0, 1.0, 1.0) direction=(0.0, 1.0, 0.0)",
    "get_points_from_angles": "distance elevation azimuth degrees=True",
    "vertices_to_faces": "vertices faces",
    "load_obj": "filename_obj normalization=True texture_size=4 load_texture=False texture_wrapping='REPEAT' "
    "use_bilinear=True",
    "save_obj": "filename vertices faces textures=None",
    "Mesh": "vertices faces=None textures=None texture_size=4",
    "Mesh.fromobj": "filename_obj normalization=True load_texture=False texture_size=4",
    "Mesh.get_batch": "batch_size",
    "Mesh.set_lr": "lr_vertices lr_textures",
    "cross": "a b",
}


@pytest.mark.parametrize("name", SIGNATURES)
def test_names_arguments_order_and_defaults(name):
    """New arguments may follow the published ones."""
    owner, _, member = name.partition(".")
    function = getattr(getattr(nr, owner), member) if member else getattr(nr, owner)
    given = [p for p in inspect.signature(function).parameters.values() if p.name != "self"]
    written = [p.name if p.default is p.empty else f"{p.name}={p.default!r}" for p in given]
    assert f"{' '.join(written)} ".startswith(SIGNATURES[name] + " ")


# A square at z = 2 that fills the screen, of one colour, cut into two triangles that run counter-clockwise.
SQUARE = [[-1.0, -1, 2], [1, -1, 2], [1, 1, 2], [-1, 1, 2]]
CUT = [[0, 1, 2], [0, 2, 3]]
COLOR = [0.25, 0.5, 1.0]
EYE3 = [[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]
PINHOLE = {"K": [[[4.0, 0, 2], [0, 4, 2], [0, 0, 1]]], "R": [EYE3], "t": [[[0.0, 0, 0]]], "orig_size": 4}


def square(device, batch=1, size=1):
    vertices = torch.tensor(SQUARE, device=device).expand(batch, 4, 3)
    textures = torch.tensor(COLOR, device=device).expand(batch, 2, size, size, size, 3)
    return vertices, torch.tensor(CUT, dtype=torch.int32, device=device).expand(batch, 2, 3), textures


def plain(**options):
    """Make a renderer without a camera: vertices are in screen space."""
    return nr.Renderer(**{"image_size": 4, "camera_mode": "none", "light_intensity_directional": 0, **options})


def corners(device):
    vertices, faces, textures = square(device)
    return nr.vertices_to_faces(vertices, faces), textures


def one_light(device, direction):
    return nr.lighting(*corners(device), 0.5, 0.25, (1, 1, 0), [0, 1, 1], direction)[0, 0, 0, 0, 0]


POINT = [[[1.0, 2.0, 10.0]]]
ANSWERS = {
    # Points around the origin: azimuth 0 on -z, 90 degrees on +x; elevation towards +y.
    "angles": (lambda d: nr.get_points_from_angles(2, 0, 0), [0.0, 0, -2]),
    "angles of a quarter turn": (lambda d: nr.get_points_from_angles(2, 0, 90.0), [2.0, 0, 0]),
    "angles upwards": (lambda d: nr.get_points_from_angles(2.0, 90, 0), [0.0, 2, 0]),
    "angles in radians": (lambda d: nr.get_points_from_angles(2, 0, np.pi / 2, degrees=False), [2.0, 0, 0]),
    "angles of arrays": (
        lambda d: nr.get_points_from_angles(np.float32([1, 2]), np.float32([0, 0]), np.int64([0, 90])),
        [[0.0, 0, -1], [2, 0, 0]],
    ),
    # Left-handed cameras: x to the right of a viewer for whom the world is mirrored.
    "look_at": (lambda d: nr.look_at(torch.tensor([[[1.0, 2, 0]]], device=d), [0, 0, -3]), [[[1.0, 2, 3]]]),
    "look_at a point": (lambda d: nr.look_at(torch.tensor(POINT, device=d), (0, 0, 0), at=(0, 0, 5)), POINT),
    "look_at upside down": (
        lambda d: nr.look_at(torch.tensor(POINT, device=d), np.zeros(3), at=[0, 0, 1], up=np.float64([0, -1, 0])),
        [[[-1.0, -2, 10]]],
    ),
    "look": (lambda d: nr.look(torch.tensor(POINT, device=d), (1, 2, 0)), [[[0.0, 0, 10]]]),
    "look along x": (
        lambda d: nr.look(torch.tensor(POINT, device=d), [0, 0, 0], direction=[1, 0, 0]),
        [[[-10.0, 2, 1]]],
    ),
    "perspective": (lambda d: nr.perspective(torch.tensor(POINT, device=d), 45), [[[0.1, 0.2, 10]]]),
    "perspective by name": (
        lambda d: nr.perspective(vertices=torch.tensor(POINT, device=d), angle=45),
        [[[0.1, 0.2, 10]]],
    ),
    # OpenCV's camera: pixels downwards, the screen upwards.
    "projection": (lambda d: nr.projection(torch.tensor(POINT, device=d), **PINHOLE), [[[0.2, -0.4, 10]]]),
    "projection, distorted": (
        lambda d: nr.projection(torch.tensor([[[1.0, 0, 1]]], device=d), **PINHOLE, dist_coeffs=[[0.5, 0.25, 0, 0, 1]]),
        [[[5.5, 0.0, 1]]],
    ),
    # Light on the side of (v0 - v1) x (v2 - v1): here -z, where the camera is.
    "lighting": (lambda d: one_light(d, (0, 0, -1)), [0.125, 0.375, 0.25]),
    "lighting from behind": (lambda d: one_light(d, [0, 0, 1]), [0.125, 0.25, 0]),
    "vertices_to_faces": (lambda d: corners(d)[0][0, 1], [SQUARE[0], SQUARE[2], SQUARE[3]]),
    "rasterize": (lambda d: nr.rasterize(*corners(d), 4)[0, :, 1, 2], COLOR),
    "rasterize_silhouettes": (lambda d: nr.rasterize_silhouettes(corners(d)[0], 4)[0], [[1.0] * 4] * 4),
    "rasterize_depth": (lambda d: nr.rasterize_depth(corners(d)[0], 4)[0], [[2.0] * 4] * 4),
    "rasterize_depth behind far": (lambda d: nr.rasterize_depth(corners(d)[0], 2, far=1.5)[0], [[1.5] * 2] * 2),
    "rasterize on a background": (
        lambda d: nr.rasterize(corners(d)[0] + 5, corners(d)[1], 4, background_color=(1, 0, 0.5))[0, :, 0, 0],
        [1, 0, 0.5],
    ),
    # The top row of an image shows y = 3/4; `Rasterize` begins with the bottom row.
    "the upper half": (lambda d: nr.rasterize_silhouettes(upper(d), 4, False)[0, :, 1], [1.0, 1, 0, 0]),
    "the upper half of Rasterize": (lambda d: bottom_up(d)[1][0, :, 1], [0.0, 0, 1, 1]),
    "colours of Rasterize": (lambda d: bottom_up(d)[0][0, 3, 1], COLOR),
    # Half of the ambient light falls on everything.
    "render": (lambda d: plain()(*square(d))[0][0, :, 2, 2], [0.125, 0.25, 0.5]),
    "depth of render": (lambda d: plain()(*square(d))[1][0], [[2.0] * 4] * 4),
    "alpha of render": (lambda d: plain()(*square(d))[2][0], [[1.0] * 4] * 4),
    "in perspective": (
        lambda d: look(d, perspective=True, viewing_angle=45).render_depth(*square(d)[:2])[0, :, 1],
        [100.0, 2, 2, 100],
    ),
    "without": (lambda d: look(d, perspective=False).render_depth(*square(d)[:2])[0, :, 1], [2.0] * 4),
    "calibrated": (
        lambda d: plain(camera_mode="projection", anti_aliasing=False, **PINHOLE).render_depth(*square(d)[:2])[0, :, 1],
        [2.0] * 4,
    ),
    "turned over": (lambda d: plain().render_silhouettes(square(d)[0], square(d)[1].flip(2))[0, 0], [1.0] * 4),
    "turned over, one side": (
        lambda d: plain(fill_back=False).render_silhouettes(square(d)[0], square(d)[1].flip(2))[0, 0],
        [0.0] * 4,
    ),
}


def look(device, **options):
    renderer = plain(camera_mode="look", anti_aliasing=False, **options)
    renderer.eye = [0, 0, 0]
    return renderer


def upper(device):
    return corners(device)[0] * torch.tensor([1, 0.5, 1], device=device) + torch.tensor([0, 0.5, 0], device=device)


def bottom_up(device):
    return nr.Rasterize(4, 0.1, 100, 1e-4, (0, 0, 0), True, True, True)(upper(device), corners(device)[1])


@pytest.mark.parametrize("name", ANSWERS)
def test_answers(device, name):
    """Within some roundings of float32, of numbers up to 100."""
    call, expected = ANSWERS[name]
    found = call(device)
    found = found.cpu() if isinstance(found, torch.Tensor) else torch.tensor(found)
    torch.testing.assert_close(found, torch.tensor(expected, dtype=torch.float32), rtol=1e-6, atol=1e-6)


def test_points_of_plain_numbers_are_tuples():
    """Programs unpack, compare and stack them."""
    eye = nr.get_points_from_angles(2, np.float64(0), 0)
    assert type(eye) is tuple and eye == (0, 0, -2) and torch.tensor([eye, eye]).shape == (2, 3)


SHAPES = {
    None: [("rgb", (2, 3, 4, 4)), ("depth", (2, 4, 4)), ("alpha", (2, 4, 4))],
    "rgb": [("rgb", (2, 3, 4, 4))],
    "silhouettes": [("alpha", (2, 4, 4))],
    "depth": [("depth", (2, 4, 4))],
}


@pytest.mark.parametrize("anti_aliasing", [True, False])
@pytest.mark.parametrize("mode", SHAPES)
def test_shapes_dtypes_and_gradients(device, mode, anti_aliasing):
    """Images are contiguous float32. They require a gradient only if an input does."""
    for leaf in (None, "vertices", "textures"):
        vertices, faces, textures = square(device, 2)
        vertices = vertices.clone().requires_grad_(leaf == "vertices")
        textures = textures.clone().requires_grad_(leaf == "textures")
        images = plain(anti_aliasing=anti_aliasing)(vertices, faces, textures, mode=mode)
        for (name, shape), image in zip(SHAPES[mode], images if mode is None else [images], strict=True):
            assert image.shape == shape and image.dtype == torch.float32 and image.is_contiguous()
            assert image.device == vertices.device
            assert image.requires_grad or leaf is None or (leaf == "textures" and name != "rgb")
            assert not image.requires_grad or leaf == "vertices" or (leaf == "textures" and mode in (None, "rgb"))
    assert all(part.is_contiguous() for part in bottom_up(device))


def made(folder):
    """All tensors that old names make of files and numbers."""
    nr.save_obj(folder / "m.obj", *nr.cube(), torch.rand(12, 2, 2, 2, 3))
    vertices, faces, textures = nr.load_obj(folder / "m.obj", load_texture=True)
    noise, loaded = (nr.Mesh.fromobj(folder / "m.obj", load_texture=own, texture_size=2) for own in (False, True))
    module = importlib.import_module("neural_renderer.load_obj")
    renderer = nr.Renderer(K=np.eye(3), R=PINHOLE["R"], t=np.zeros((1, 3)))
    return {
        "load_obj": (vertices, faces, textures),
        "load_textures": (module.load_textures(folder / "m.obj", folder / "m.mtl", 2),),
        "Mesh.fromobj": (noise.vertices, noise.faces, noise.textures, loaded.vertices, loaded.textures),
        "Mesh": tuple(nr.Mesh(str(folder / "m.obj"), 2).get_batch(1)),
        "Renderer": (renderer.K, renderer.R, renderer.t, renderer.dist_coeffs),
    }


def test_old_names_make_tensors_on_cuda_where_there_is_one(device, tmp_path):
    """As the first packages, which knew no other device. Modern names make them on the CPU."""
    for name, tensors in made(tmp_path).items():
        assert {tensor.device.type for tensor in tensors} == {device}, name
    modern = nr.Mesh.load(tmp_path / "m.obj"), nr.UVMesh.load(tmp_path / "m.obj"), nr.Mesh.icosphere(1)
    assert {mesh.vertices.device.type for mesh in modern} == {"cpu"}
    assert (
        nr.load_mesh(tmp_path / "m.obj")[0].device.type == nr.get_points_from_angles([1, 2], 0, 0).device.type == "cpu"
    )


@pytest.mark.parametrize("available", [True, False])
def test_the_default_device_of_torch_wins(monkeypatch, available):
    monkeypatch.setattr("torch.cuda.is_available", lambda: available)
    assert old_device().type == ("cuda" if available else "cpu")
    for chosen in ("cpu", "meta"):
        with torch.device(chosen):
            assert old_device().type == chosen
        torch.set_default_device(chosen)
        try:
            assert old_device().type == chosen
        finally:
            torch.set_default_device(None)


def test_a_first_program_with_its_calls_of_cuda(device, tmp_path):
    """The first example of the port, which moves what it makes and nothing that `load_obj` gives."""

    def moved(tensor):
        return tensor.cuda() if device == "cuda" else tensor

    nr.save_obj(tmp_path / "m.obj", *nr.cube(), torch.rand(12, 2, 2, 2, 3))
    vertices, faces = nr.load_obj(tmp_path / "m.obj")
    vertices, faces = vertices[None, :, :], faces[None, :, :]
    textures = moved(torch.ones(1, faces.shape[1], 2, 2, 2, 3, dtype=torch.float32))
    renderer = nr.Renderer(camera_mode="look_at", image_size=16)
    for azimuth in (0, 120):
        renderer.eye = nr.get_points_from_angles(2.732, 0, azimuth)
        images, _, _ = renderer(vertices, faces, textures)
        assert images.detach().cpu().numpy()[0].transpose((1, 2, 0)).max() > 0.25
    mesh = nr.Mesh.fromobj(tmp_path / "m.obj", load_texture=True)
    assert renderer(mesh.vertices[None], mesh.faces[None], mesh.textures[None])[2].max() == 1


VECTORS = ["eye", "camera_direction", "camera_up", "light_color_ambient", "light_color_directional", "light_direction"]
KINDS = {
    "list": list,
    "tuple": tuple,
    "float64 array": np.array,
    "float32 array": np.float32,
    "list of numpy numbers": lambda value: list(np.array(value)),
    "tensor": torch.tensor,
    "parameter": lambda value: torch.nn.Parameter(torch.tensor(value)),
    "one for each image": lambda value: torch.tensor(value).expand(2, -1),
}


@pytest.mark.parametrize("kind", KINDS)
def test_attributes_of_any_kind_are_set_later(device, kind):
    """Lists, tuples, arrays, tensors, on the CPU even beside a mesh on CUDA, for one image or for all."""
    vertices, faces, textures = square(device, 2)
    values = [[0.1, 0.2, -1], [0.0, 0.1, 1], [0.2, 1, 0], [0.5, 0.25, 1], [1, 0.5, 0.25], [0.1, 0.5, -1]]

    def images(make):
        renderer = nr.Renderer(8, camera_mode="look")
        for name, value in zip([*VECTORS, "background_color"], [*values, [0.25, 0.5, 0.75]], strict=True):
            setattr(renderer, name, make([float(number) for number in value]))
        renderer.light_intensity_ambient = make([0.25])[0] if kind == "tensor" else 0.25
        return renderer(vertices, faces, textures)

    for found, expected in zip(images(KINDS[kind]), images(list), strict=True):
        torch.testing.assert_close(found.detach(), expected, rtol=1e-6, atol=1e-6)


def test_lights_for_each_image(device):
    renderer = plain(camera_mode="none")
    renderer.light_intensity_ambient = torch.tensor([0.25, 0.5])
    renderer.light_intensity_directional = torch.tensor([0.5, 0.25])
    renderer.light_color_ambient = torch.tensor([[1.0, 0, 0], [0, 1, 0]])
    renderer.light_direction = torch.tensor([[0.0, 0, -1], [0, 0, 1]])
    rgb = renderer(*square(device, 2))[0][:, :, 0, 0].cpu()
    expected = torch.tensor([[0.75, 0.5, 0.5], [0.0, 0.5, 0.0]]) * torch.tensor(COLOR)
    torch.testing.assert_close(rgb, expected, rtol=1e-6, atol=0)


def test_callers_tensors_are_left_alone_and_results_are_theirs(device):
    """Arguments are not changed. Results may be changed in place before `backward`."""
    vertices, faces, textures = (part.clone() for part in square(device, 2, 2))
    vertices.requires_grad_(), textures.requires_grad_()
    before = vertices.detach().clone(), faces.clone(), textures.detach().clone()
    results = [
        nr.look_at(vertices, [0, 0, -3]),
        nr.look(vertices, [0, 0, -3]),
        nr.perspective(vertices),
        nr.projection(vertices, **PINHOLE),
        nr.vertices_to_faces(vertices, faces),
        nr.lighting(nr.vertices_to_faces(vertices, faces), textures),
        *nr.rasterize_rgbad(nr.vertices_to_faces(vertices, faces), textures, 8, far=10).values(),
        *plain()(vertices, faces, textures),
    ]
    for result in results:
        result[:, :1] *= -1
        result[result > 0.5] = 0
    sum(result.square().sum() for result in results).backward()
    for now, was in zip((vertices, faces, textures), before, strict=True):
        assert torch.equal(now.detach(), was)
    assert vertices.grad.isfinite().all() and textures.grad.any()


def test_subclasses_and_unknown_attributes(device):
    class Fainter(nr.Renderer):
        def render(self, vertices, faces, textures=None, *camera):
            return super().render(vertices, faces, textures / 2, *camera)[0]

        def render_silhouettes(self, *arguments):
            return super().render_silhouettes(*arguments) * 3

    renderer = Fainter(image_size=4, camera_mode="none", light_intensity_directional=0)
    renderer.light_intensity_direction = 0.3  # a slip of the pen in several programs
    assert torch.equal(renderer(*square(device)), plain()(*square(device))[0] / 2)
    assert (renderer(*square(device)[:2], mode="silhouettes") == 3).all()


COPIES = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda renderer: pickle.loads(pickle.dumps(renderer)),
    "to": lambda renderer: renderer.to("cpu").float(),
}


@pytest.mark.parametrize("kind", COPIES)
def test_copies_and_pickles(device, kind):
    renderer = nr.Renderer(4, K=PINHOLE["K"], R=torch.eye(3), t=[0, 0, 0.5], orig_size=4, near=0.5)
    renderer.background_color, renderer.camera_mode, renderer.own = [0.5, 0, 1], "look_at", "a word"
    other = COPIES[kind](renderer)
    assert type(other) is nr.Renderer and vars(other).keys() == vars(renderer).keys() and other.own == "a word"
    for camera_mode in ("projection", "look_at"):
        renderer.camera_mode = other.camera_mode = camera_mode
        assert all(map(torch.equal, other(*square(device)), renderer(*square(device))))


def test_state_is_what_is_a_parameter(device):
    renderer = nr.Renderer(4, camera_mode="look_at", K=np.eye(3))
    assert not renderer.state_dict() and not list(renderer.buffers())
    renderer.eye = torch.nn.Parameter(torch.tensor([0.1, 0.2, -3.0], device=device))
    assert list(renderer.state_dict()) == ["eye"]
    renderer(*square(device))[1].sum().backward()
    assert renderer.eye.grad.any()


def test_a_mesh_in_a_network_adds_no_keys(device, tmp_path):
    """In the port it is no module: its tensors are those that it was given, and textures of noise are a leaf."""
    nr.save_obj(tmp_path / "m.obj", *nr.cube())
    network = torch.nn.Linear(2, 2)
    before = set(network.state_dict())
    network.template = nr.Mesh.fromobj(tmp_path / "m.obj")
    network.other = nr.Mesh(*nr.cube(), texture_size=2)
    assert set(network.state_dict()) == before == {name for name, _ in network.named_parameters()}
    noise = network.to(device).template.textures
    assert noise.is_leaf and noise.requires_grad
    plain()(network.template.vertices[None], network.template.faces[None], noise[None])[0].sum().backward()
    assert noise.grad is not None
    chain = nr.Mesh(str(tmp_path / "m.obj"), 2)  # of the Chainer package: a link with two parameters
    assert set(chain.state_dict()) == {"vertices", "textures"}


def test_gradients_flow_through_a_mesh_to_what_it_is_given(device):
    vertices, faces = (part.to(device) for part in nr.cube())
    x, colors = torch.ones_like(vertices, requires_grad=True), torch.rand(12, 1, 1, 1, 3, device=device)
    colors.requires_grad_()
    mesh = nr.Mesh(x * vertices, faces, colors * 0.5)
    mesh.vertices.sum().backward(retain_graph=True)
    assert x.grad.any()
    renderer = nr.Renderer(16, camera_mode="look_at")
    renderer(mesh.vertices[None], mesh.faces[None], mesh.textures[None])[0].sum().backward()
    assert colors.grad.any()
    mesh.vertices = x * 2
    mesh.textures = torch.nn.Parameter(colors.detach())
    assert mesh.vertices.grad_fn is not None and list(mesh.state_dict()) == ["textures"]


def test_pickles_of_the_first_packages(device):
    """They lack the attributes of other camera modes, and newer attributes."""
    wanted = nr.Renderer(4, camera_mode="look_at")
    old = copy.copy(wanted)
    for name in ("K", "R", "t", "dist_coeffs", "orig_size", "camera_up", "gradient"):
        del old.__dict__[name]
    old.far = 50
    found = pickle.loads(pickle.dumps(old))
    assert found.far == 50 and found.camera_up == [0, 1, 0]
    assert torch.equal(found(*square(device))[0], wanted(*square(device))[0])


@pytest.mark.parametrize(
    ("vertices", "faces", "sentence"),
    [
        (float("nan"), 0, "vertices: expected finite numbers"),
        (0, 9, r"faces: expected indices in \[0, 4\)"),
    ],
)
def test_wrong_numbers_are_told_unless_asked_not_to(device, vertices, faces, sentence):
    points, triangles, textures = (part.clone() for part in square(device))
    points[0, 0, 0] += vertices
    triangles[0, 0, 0] += faces
    with pytest.raises(ValueError, match=sentence):
        plain()(points, triangles, textures)
    nr.check_values(False)
    try:
        rgb, depth, alpha = plain()(points, triangles, textures)
    finally:
        nr.check_values(True)
    assert alpha.sum() < 16 and depth.isfinite().all() and rgb.isfinite().all()


def test_names_of_forks_have_an_answer(device):
    """The rows of docs/compatibility.md for what changed copies of the port have."""
    corners = upper(device)
    code = (
        (ROOT / "docs" / "compatibility.md").read_text(encoding="utf-8").partition("```python\n")[2].partition("```")[0]
    )
    names = {"torch": torch, "corners": corners}
    exec(code, names)
    mesh = names["clip"], names["triangles"]
    found = nr.fragments(mesh, None, 4, anti_aliasing=False, two_sided=False)
    assert (found.face_index[0].cpu() >= 0).tolist() == [[True] * 4] * 2 + [[False] * 4] * 2
    # The two triangles meet on the diagonal from the lower left to the upper right.
    assert found.face_index[0, 0, 0] == 1 and found.face_index[0, 1, 3] == 0
    torch.testing.assert_close(found.weights.sum(-1).cpu(), (found.face_index.cpu() >= 0).float())
    wide = nr.Renderer((2, 4), camera_mode="none"), nr.Renderer(camera_mode="none", image_width=4, image_height=2)
    assert all(renderer(*square(device)[:2], mode="silhouettes").shape == (1, 2, 4) for renderer in wide)


def test_near_may_be_below_zero(device):
    """Then all that is in front of the camera is drawn, as by the port, which divided by depths."""
    at_zero, below = (nr.rasterize_silhouettes(upper(device), 4, near=near) for near in (0, -100))
    assert at_zero.any() and torch.equal(at_zero, below)
    vertices, faces, textures = square(device)
    images = [plain(near=near)(vertices, faces, textures) for near in (0, -0.5)]
    assert images[0][2].any() and all(map(torch.equal, *images))
    behind = upper(device) * torch.tensor([1.0, 1.0, -3.0], device=device)
    with pytest.raises(ValueError, match="near: expected 0 or more for faces behind the camera, at depth -"):
        nr.rasterize_silhouettes(behind, 4, near=-100)


def test_name():
    """The port has it, and no module or function may take its place."""
    assert nr.name == "neural_renderer_pytorch" and "name" not in dir(nr)


def test_chainers_names(device):
    """Of the Chainer package, with torch's tensors and optimisers."""
    mesh = nr.Mesh(*nr.cube(0.7), texture_size=2).to(device).trainable()
    mesh.set_lr(0.5, 2.0)
    vertices, faces, textures = mesh.get_batch(3)
    assert vertices.shape == (3, 8, 3) and faces.shape == (3, 12, 3) and textures.shape == (3, 12, 2, 2, 2, 3)
    assert torch.equal(textures[0], torch.sigmoid(mesh.textures))
    optimizer = nr.Adam(mesh.parameters(), alpha=0.1, beta1=0.5)
    before = mesh.vertices.detach().clone()
    (1 - nr.Renderer(8, camera_mode="look_at").render_silhouettes(vertices, faces)).sum().backward()
    optimizer.step()
    moved = (mesh.vertices - before).abs()
    # The first step of Adam is its rate, here 0.1 times the vertices' 0.5, where there is a gradient, and 0 elsewhere.
    gradient = mesh.vertices.grad
    assert not moved[gradient == 0].any() and (moved[gradient.abs() > 1e-3] - 0.05).abs().max() < 1e-5
