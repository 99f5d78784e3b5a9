"""Derivatives other than a plain backward pass: `torch.func`, second derivatives, forward mode, float64."""

from __future__ import annotations

import pytest
import torch
from torch.autograd import forward_ad
from torch.func import grad, hessian, jacrev, jvp, linearize, vjp, vmap

import neural_renderer as nr

SIZE = 12


def scene(device):
    vertices, faces = (t.to(device) for t in nr.icosphere(1))
    cubes = torch.rand(len(faces), 2, 2, 2, 3, generator=torch.Generator().manual_seed(0)).to(device)
    return vertices, faces, cubes, torch.tensor([0.3, 0.2, -2.7], device=device)


def losses(device):
    """Functions of one tensor each, through kernels of vertices, cameras, textures, light and attributes."""
    vertices, faces, cubes, eye = scene(device)
    camera = nr.Camera.look_at(eye, viewing_angle=25)
    weight = torch.linspace(-1, 1, SIZE, device=device)

    def color(vertices=vertices, cubes=cubes, eye=eye, light=None):
        camera = nr.Camera.look_at(eye, viewing_angle=25)
        rgb = nr.render((vertices, faces, cubes), camera, SIZE, outputs=("rgb",), light=light).rgb
        return (rgb.square() * weight).sum()

    def attributes(values):
        seen = nr.fragments((vertices, faces), camera, SIZE)
        return (seen.composite(seen.interpolate(values)).square() * weight).sum()

    places = torch.rand(1, 5, 5, 2, generator=torch.Generator().manual_seed(1)).to(device)

    def image(values):
        return nr.sample_texture(values, places).square().sum()

    texture = torch.rand(9, 7, 3, generator=torch.Generator().manual_seed(3)).to(device)
    material = nr.Material(base_color=torch.tensor([0.9, 0.5, 0.2], device=device))
    mapped = nr.UVMesh(vertices, faces, vertices[:, :2] / 2 + 0.5, texture, materials=[material])

    def tinted(eye):
        return (nr.render(mapped, nr.Camera.look_at(eye, viewing_angle=25), SIZE, outputs=("rgb",)).rgb * weight).sum()

    return {
        "vertices": (lambda v: color(vertices=v), vertices),
        "camera": (lambda e: color(eye=e), eye),
        "textures": (lambda t: color(cubes=t), cubes),
        "light": (lambda d: color(light=nr.Light(direction=d)), torch.tensor([0.1, 0.9, -0.4], device=device)),
        "attributes": (attributes, vertices),
        "images": (image, torch.rand(6, 6, 3, device=device)),
        "mapped": (tinted, eye),
    }


NAMES = ["vertices", "camera", "textures", "light", "attributes", "images", "mapped"]


@pytest.mark.parametrize("name", NAMES)
def test_func_grad_and_vmap_are_backward_and_a_loop(device, name):
    loss, value = losses(device)[name]
    several = torch.stack((value, 0.9 * value))
    expected = []
    for one in several:
        leaf = one.clone().requires_grad_()
        expected.append(torch.autograd.grad(loss(leaf), leaf)[0])
    # The kernels run on the same numbers; sums of torch around them may differ by rounding.
    close = {"rtol": 1e-4, "atol": 1e-5 * float(torch.stack(expected).abs().max())}
    torch.testing.assert_close(grad(loss)(several[0]), expected[0], **close)
    torch.testing.assert_close(vmap(grad(loss))(several), torch.stack(expected), **close)
    torch.testing.assert_close(grad(lambda x: vmap(loss)(x).sum())(several), torch.stack(expected), **close)
    torch.testing.assert_close(vmap(loss)(several), torch.stack([loss(one) for one in several]), rtol=1e-5, atol=1e-5)


def test_jacobian_of_an_image(device):
    """Its product with the gradient of a loss is the loss's gradient."""
    vertices, faces, cubes, eye = scene(device)

    def draw(eye):
        return nr.render((vertices, faces, cubes), nr.Camera.look_at(eye), 4, outputs=("rgb",)).rgb

    jacobian = jacrev(draw)(eye)
    assert jacobian.shape == (1, 3, 4, 4, 3)
    expected = grad(lambda e: draw(e).sum())(eye)
    torch.testing.assert_close(jacobian.sum((0, 1, 2, 3)), expected, rtol=1e-3, atol=1e-4 * float(jacobian.abs().sum()))


@pytest.mark.parametrize("name", NAMES)
def test_forward_mode(device, name):
    """All of its forms agree with the gradient, without gradients too; sums of torch may differ by rounding."""
    loss, value = losses(device)[name]
    along = torch.randn(value.shape, generator=torch.Generator().manual_seed(2)).to(device)
    expected = (grad(loss)(value) * along).sum()
    close = {"rtol": 1e-4, "atol": 1e-5 * float((grad(loss)(value) * along).abs().sum())}
    with torch.no_grad():
        torch.testing.assert_close(jvp(loss, (value,), (along,))[1], expected, **close)
    several, linear = torch.stack((along, -2 * along)), linearize(loss, value)[1]
    torch.testing.assert_close(linear(along), expected, **close)
    for push in (linear, lambda v: jvp(loss, (value,), (v,))[1]):
        found, right = vmap(push)(several), torch.stack((expected, -2 * expected))
        torch.testing.assert_close(found, right, rtol=1e-4, atol=2 * close["atol"])
    with forward_ad.dual_level():
        found = forward_ad.unpack_dual(loss(forward_ad.make_dual(value, along)))
    torch.testing.assert_close(found.primal, loss(value))
    torch.testing.assert_close(found.tangent, expected, **close)


def scenes_to_shade(device):
    """Functions of vertices [V, 3] to images, one for each way to shade."""
    vertices, faces, cubes, eye = scene(device)
    camera = nr.Camera.look_at(eye, viewing_angle=25)
    image = torch.rand(9, 7, 3, generator=torch.Generator().manual_seed(3)).to(device)
    uv = vertices[:, :2] / 2 + 0.5

    def colored(output="rgb", camera=camera, **options):
        return lambda v: getattr(nr.render((v, faces, cubes), camera, SIZE, outputs=(output,), **options), output)

    def mapped(**options):
        return lambda v: nr.render(nr.UVMesh(v, faces, uv, image), camera, SIZE, outputs=("rgb",), **options).rgb

    harmonics = nr.SphericalHarmonicLight(torch.rand(9, 3, generator=torch.Generator().manual_seed(4)).to(device))
    lamp = nr.PointLight(position=torch.tensor([1.0, 2.0, -2.0], device=device))
    return {
        "alpha": colored("alpha"),
        "depth": colored("depth", anti_aliasing=False),
        "cubes": colored(),
        "orthographic": colored(camera=nr.Camera.look_at(eye, orthographic=True)),
        "several cameras": colored(camera=nr.Camera.look_at(torch.stack((eye, -eye)))),
        "point light": colored(light=[nr.Light(), lamp]),
        "harmonics": colored(light=harmonics),
        "smooth": colored(shading="smooth"),
        "phong": colored(shading=nr.Phong(), light=lamp),
        "pbr": mapped(shading=nr.PBR(), light=lamp),
        "image": mapped(),
        "layers": mapped(layers=2),
    }


@pytest.mark.parametrize("name", scenes_to_shade("cpu"))
def test_derivative_of_an_image(device, name):
    """For a motion of vertices it is a picture, whose product with any picture is that of the gradient."""
    draw, vertices = scenes_to_shade(device)[name], scene(device)[0]
    random = torch.Generator().manual_seed(5)
    along = torch.randn(vertices.shape, generator=random).to(device)
    image, change = jvp(draw, (vertices,), (along,))
    pull = torch.randn(image.shape, generator=random).to(device)
    leaf = vertices.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(draw(leaf), leaf, pull)
    torch.testing.assert_close(image, draw(vertices), rtol=0, atol=1e-5)
    size = float((gradient * along).abs().sum() + (change * pull).abs().sum())
    assert abs(float((change * pull).sum() - (gradient * along).sum())) <= 1e-5 * size
    assert change.abs().max() > 0.1


@pytest.mark.parametrize("name", NAMES)
def test_second_derivatives_by_forward_mode_are_refused(device, name):
    """An error with a sentence, never a zero; `jacrev` twice gives those of what is smooth."""
    loss, value = losses(device)[name]
    with pytest.raises(RuntimeError, match=r"reverse mode only|first derivatives only"):
        hessian(loss)(value)


@pytest.mark.parametrize("name", ["vertices", "camera"])
def test_second_derivatives_through_visibility_are_refused(device, name):
    loss, value = losses(device)[name]
    leaf = value.clone().requires_grad_()
    (first,) = torch.autograd.grad(loss(leaf), leaf, create_graph=True)
    with pytest.raises(RuntimeError, match="the rasteriser has first derivatives only"):
        torch.autograd.grad(first.square().sum(), leaf)
    with pytest.raises(RuntimeError, match="the rasteriser has first derivatives only"):
        grad(lambda x: grad(loss)(x).square().sum())(value)


def lit_scene(device):
    """A loss of everything smooth at once, as one vector: textures, light, background."""
    vertices, faces, cubes, eye = scene(device)
    camera, weight = nr.Camera.look_at(eye, viewing_angle=25), torch.linspace(-1, 1, SIZE, device=device)
    image = torch.rand(5, 5, 3, generator=torch.Generator().manual_seed(3)).to(device)
    uv = vertices[:, :2] / 2 + 0.5

    def loss(several):
        own, glow, beam, towards, behind = several.split([cubes.numel(), 3, 3, 3, 3])
        light = nr.Light(ambient_color=glow, directional_color=beam, direction=towards)
        options = {"light": light, "background": behind, "outputs": ("rgb",)}
        flat = nr.render((vertices, faces, own.view_as(cubes)), camera, SIZE, **options).rgb
        mapped = nr.UVMesh(vertices, faces, uv, image * behind)
        sharp = nr.render(mapped, camera, SIZE, anti_aliasing=False, **options).rgb
        smooth = nr.render(mapped, camera, SIZE, shading="smooth", **options).rgb
        return ((flat.square() + sharp.square() + smooth.square()) * weight).sum()

    light = torch.tensor([0.4, 0.5, 0.6, 0.7, 0.6, 0.5, 0.23, 0.81, -0.37, 0.3, 0.2, 0.6], device=device)
    return loss, torch.cat((cubes.flatten(), light))


@pytest.mark.parametrize("name", ["textures", "light", "attributes", "images", "all"])
def test_second_derivatives_of_what_is_smooth(device, name):
    """Times a vector, they are the change of the gradient along it: colours are products of few numbers."""
    loss, value = lit_scene(device) if name == "all" else losses(device)[name]
    along = torch.randn(value.shape, generator=torch.Generator().manual_seed(2)).to(device)
    leaf = value.clone().requires_grad_()
    (first,) = torch.autograd.grad(loss(leaf), leaf, create_graph=True)
    (second,) = torch.autograd.grad((first * along).sum(), leaf)
    step = 0.005  # the light on no face begins or ends within it
    expected = (grad(loss)(value + step * along) - grad(loss)(value - step * along)) / (2 * step)
    # Differences lose two digits to rounding; their own error is of the square of the step.
    torch.testing.assert_close(second, expected, rtol=2e-3, atol=2e-3 * float(expected.abs().max()))
    torch.testing.assert_close(
        grad(lambda x: (grad(loss)(x) * along).sum())(value), second, rtol=1e-4, atol=1e-4 * float(second.abs().max())
    )


@pytest.mark.parametrize("perspective", [False, True])
@pytest.mark.parametrize("anti_aliasing", [False, True])
def test_drawing_in_float64(device, perspective, anti_aliasing):
    """The images are those of float32, and have all derivatives but those through visibility."""
    vertices, faces, cubes, eye = scene(device)
    vertices = vertices.double()
    screen = nr.Camera.look_at(eye.double(), viewing_angle=25)(vertices)[:, faces.long()]
    options = {"anti_aliasing": anti_aliasing, "perspective": perspective}

    def draw(cubes, direction, background, screen=screen, dtype=torch.float64):
        light = nr.Light(direction=direction).two_sided(vertices[faces.long()][None])
        own = {"textures": cubes, "light": light, "background": background, "dtype": dtype}
        return nr.rasterize_images(screen, 4, **own, **options)

    smooth = (
        cubes[None].double().requires_grad_(),
        torch.tensor([0.1, 0.9, -0.4], device=device, dtype=torch.float64, requires_grad=True),
        torch.rand(3, 4, 4, device=device, dtype=torch.float64, requires_grad=True),
    )
    images = draw(*smooth)
    for own, other in zip(images, draw(*smooth, dtype=torch.float32), strict=True):
        assert own.dtype == torch.float64 and other.dtype == torch.float32
        torch.testing.assert_close(own.float(), other, rtol=1e-5, atol=1e-5)
    assert torch.autograd.gradcheck(lambda *x: draw(*x).rgb, smooth, check_forward_ad=True, fast_mode=True)
    assert torch.autograd.gradgradcheck(lambda *x: draw(*x).rgb, smooth, fast_mode=True)
    moving = screen.clone().requires_grad_()
    for image in (draw(*smooth, screen=moving).rgb, draw(*smooth, screen=moving).depth):
        with pytest.raises(RuntimeError, match="expected vertices and cameras that need no gradient"):
            image.sum().backward()
    with pytest.raises(TypeError, match=r"dtype: expected torch\.float32 or torch\.float64"):
        draw(*smooth, dtype=torch.float16)


@pytest.mark.parametrize("of_corners", [False, True])
def test_attributes_in_float64(device, of_corners):
    vertices, faces, _, eye = scene(device)
    seen = nr.fragments((vertices, faces), nr.Camera.look_at(eye, viewing_angle=25), 4)
    shape = (len(faces), 3, 2) if of_corners else (len(vertices), 2)
    values = torch.rand(shape, device=device, dtype=torch.float64, requires_grad=True)

    def mix(values):
        return seen.interpolate(values, dtype=torch.float64)

    assert mix(values).dtype == torch.float64
    torch.testing.assert_close(mix(values).float(), seen.interpolate(values), rtol=1e-5, atol=1e-5)
    assert torch.autograd.gradcheck(mix, values, check_forward_ad=True, fast_mode=True)
    assert torch.autograd.gradgradcheck(mix, values, fast_mode=True)


def test_cameras_and_regularisers_have_all_derivatives(device):
    """They are plain torch: float64 in and out, forward mode, vmap, second derivatives."""
    vertices, faces, _, eye = (t.double() if t.is_floating_point() else t for t in scene(device))
    smooth = {
        "look_at": (lambda e: nr.Camera.look_at(e)(vertices), eye),
        "project": (lambda v: nr.Camera.look_at(eye)(v), vertices[:4]),
        "laplacian": (lambda v: nr.losses.laplacian(v, faces), vertices),
        "edge_length": (lambda v: nr.losses.edge_length(v, faces), vertices),
        "normal_consistency": (lambda v: nr.losses.normal_consistency(v, faces), vertices),
    }
    how = {"fast_mode": True, "nondet_tol": 1e-10}  # on CUDA torch sums over faces and edges in any order
    for function, value in smooth.values():
        leaf = value.clone().requires_grad_()
        assert function(leaf).dtype == torch.float64
        assert torch.autograd.gradcheck(function, leaf, check_forward_ad=True, check_batched_grad=True, **how)
        assert torch.autograd.gradgradcheck(function, leaf, **how)


@pytest.mark.parametrize("shading", ["flat", "smooth"])
def test_vjp_pulls_back_after_its_transformation(shading: str) -> None:
    ball, camera = nr.Mesh.icosphere(1), nr.Camera.look_at((0.0, 0.5, -2.5))
    colors = torch.rand(ball.num_vertices, 3)

    def image(vertices: torch.Tensor) -> torch.Tensor:
        return nr.render(nr.Mesh(vertices, ball.faces, vertex_colors=colors), camera, 16, shading=shading).rgb

    weights = torch.rand(1, 3, 16, 16)
    leaf = ball.vertices.clone().requires_grad_()
    (image(leaf) * weights).sum().backward()
    [found] = vjp(image, ball.vertices)[1](weights)
    assert torch.equal(found, leaf.grad)


def test_vmap_is_quiet(capfd):
    """torch asks users to report operators without a rule for vmap."""
    vertices, faces = nr.icosphere(1)
    textures, camera = torch.rand(len(faces), 2, 2, 2, 3), nr.Camera.look_at((0.0, 0.0, -2.7))

    def brightness(scale):
        return nr.render((vertices * scale, faces, textures), camera, 16).rgb.mean()

    scales = torch.tensor([1.0, 0.8])
    found = torch.vmap(torch.func.grad(brightness))(scales)
    torch.testing.assert_close(found, torch.stack([torch.func.grad(brightness)(scale) for scale in scales]))
    assert "performance" not in capfd.readouterr().err
