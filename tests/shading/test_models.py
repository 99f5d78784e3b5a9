"""`render` with light in each pixel: flat surfaces as before, materials, gradients, messages."""

from __future__ import annotations

import dataclasses

import pytest
import torch

import neural_renderer as nr

CAMERA = nr.Camera.look_at((0.4, 1.0, -2.5), viewing_angle=30)
LAMPS = [nr.Light(0.2, 0.0), nr.PointLight((1.0, 2.0, -2.0), 4.0)]


def soup(mesh):
    """The mesh with vertices of its own for each face."""
    corners = mesh.vertices.detach()[mesh.faces.long()].reshape(-1, 3)
    return nr.Mesh(corners, torch.arange(len(corners), device=corners.device).view(-1, 3), mesh.textures)


@pytest.mark.parametrize("mirrored", [False, True])
def test_smooth_shading_of_flat_faces_is_flat_shading(mirrored, device):
    """Faces with vertices of their own, outside and, through a hole, inside."""
    ball = nr.Mesh(*nr.icosphere(1), torch.rand(80, 4, 4, 4, 3)).to(device)
    opened = soup(ball.submesh(ball.vertices[ball.faces.long()].mean(1)[:, 2] > -0.6))
    camera = dataclasses.replace(nr.Camera.look_at((0.4, 1.0, -2.5), viewing_angle=30, mirrored=mirrored))
    lights = [nr.Light(0.3, 0.6, direction=(0.5, 1.0, -0.4)), nr.SphericalHarmonicLight(torch.rand(9, 3))]
    images = [nr.render(opened.to(device), camera, 32, light=lights, shading=name).rgb for name in ("flat", "smooth")]
    torch.testing.assert_close(images[1], images[0], rtol=0, atol=1e-5)


def textured():
    vertices, faces = nr.icosphere(2)
    uv = torch.stack((0.5 + 0.5 * vertices[:, 0], 0.5 + 0.5 * vertices[:, 1]), -1)
    return nr.UVMesh(vertices, faces, uv, torch.rand(16, 16, 3))


@pytest.mark.parametrize("gradient", ["edge", "nmr"])
@pytest.mark.parametrize("shading", ["smooth", "phong", "pbr"])
def test_it_is_deferred_shading_in_one_call(shading, gradient):
    """The same image and the same gradients as by `fragments` and the functions of each model."""
    mesh, position = textured(), torch.tensor([1.0, 2.0, -2.0], requires_grad=True)
    light = [LAMPS[0], nr.PointLight(position, 4.0)]
    roots = [mesh.vertices.clone().requires_grad_(), mesh.images[0].clone().requires_grad_()]
    mesh = dataclasses.replace(mesh, vertices=roots[0], images=(roots[1],))
    target, behind = torch.rand(1, 3, 16, 16), torch.rand(3, 16, 16)

    def by_hand():
        fragments = nr.fragments(mesh, CAMERA, 16, gradient=gradient)
        frozen = dataclasses.replace(fragments, corners=fragments.corners.detach())
        still = frozen if gradient == "nmr" else fragments
        surface, albedo = nr.VisibleSurface.of(still, mesh, CAMERA), mesh.shade(still)
        if shading == "smooth":
            colors = nr.shade_diffuse(surface, albedo, light)
        elif shading == "phong":
            colors = nr.shade_phong(surface, albedo, light, 0.5, 32.0)
        else:
            colors = nr.linear_to_srgb(nr.shade_pbr(surface, nr.srgb_to_linear(albedo), 0.0, 0.5, light))
        return fragments.composite(colors, behind)

    results = []
    for draw in (
        by_hand,
        lambda: nr.render(mesh, CAMERA, 16, light=light, shading=shading, background=behind, gradient=gradient).rgb,
    ):
        image = draw()
        grads = torch.autograd.grad((image * target).sum(), (*roots, position))
        results.append((image, *grads))
    for one, other in zip(*results, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-5)


def test_materials_are_those_of_their_faces():
    """Two materials with textures: each half of a sphere as if it were alone."""
    mesh, draw = textured(), torch.Generator().manual_seed(0)

    def texture(channels):
        return nr.Texture(torch.rand(8, 8, channels, generator=draw))

    metal = nr.Material(
        metallic=0.9,
        roughness=0.8,
        metallic_roughness_texture=texture(3),
        occlusion_texture=texture(1),
        occlusion_strength=0.7,
        emissive=(0.2, 0.1, 0.3),
        emissive_texture=texture(3),
        base_color=(0.5, 0.9, 0.7),
        normal_texture=texture(3),
    )
    glossy = nr.Material(roughness=0.2, specular=(0.5, 0.4, 0.3), shininess=20.0, specular_texture=texture(3))
    index = torch.arange(len(mesh.faces)) % 3 - 1  # of −1, 0, 1
    light = [*LAMPS, nr.EnvironmentLight(torch.rand(8, 16, 3, generator=draw))]
    for shading in ("smooth", "phong", "pbr"):
        options = {"light": light, "shading": shading, "anti_aliasing": False}
        whole = dataclasses.replace(mesh, materials=(metal, glossy), material_index=index)
        image = nr.render(whole, CAMERA, 64, **options).rgb
        shown = nr.fragments(whole, CAMERA, 64, anti_aliasing=False).face_index.long()
        for number, material in ((0, metal), (1, glossy), (-1, None)):
            materials = () if material is None else (material,)
            alone = nr.render(dataclasses.replace(mesh, materials=materials), CAMERA, 64, **options).rgb
            mine = ((shown >= 0) & (index[shown] == number))[:, None].expand(-1, 3, -1, -1)
            assert mine.sum() > 500
            torch.testing.assert_close(image[mine], alone[mine], rtol=1e-4, atol=1e-5)


def test_a_material_is_read_by_hand():
    """Channels and colour spaces as glTF says: blue metallic, green roughness, red occlusion, sRGB emission."""
    mesh = textured()
    values = torch.tensor([0.3, 0.6, 0.8])
    material = nr.Material(
        base_color=(0.5, 0.9, 0.7),
        metallic=0.5,
        roughness=0.9,
        metallic_roughness_texture=nr.Texture(values.expand(2, 2, 3)),
        occlusion_texture=nr.Texture(values.expand(2, 2, 3)),
        occlusion_strength=0.4,
        emissive=(1.0, 0.5, 2.0),
        emissive_texture=nr.Texture(values.expand(2, 2, 3)),
    )
    light = [*LAMPS, nr.SphericalHarmonicLight(torch.rand(9, 3))]
    fragments = nr.fragments(mesh, CAMERA, 32)
    surface = nr.VisibleSurface.of(fragments, mesh, CAMERA)
    base = nr.srgb_to_linear(mesh.shade(fragments)) * torch.tensor([0.5, 0.9, 0.7])
    occlusion, emissive = 1 + 0.4 * (0.3 - 1), torch.tensor([1.0, 0.5, 2.0]) * nr.srgb_to_linear(values)
    radiance = nr.shade_pbr(surface, base, 0.5 * 0.8, 0.9 * 0.6, light, occlusion, emissive)
    wanted = fragments.composite(nr.linear_to_srgb(radiance))
    found = nr.render(dataclasses.replace(mesh, materials=(material,)), CAMERA, 32, light=light, shading="pbr").rgb
    torch.testing.assert_close(found, wanted, rtol=1e-4, atol=1e-5)


def test_without_light_textures_are_drawn_as_they_are():
    mesh = textured()
    plain = nr.render(mesh, CAMERA, 32, light=None).rgb
    for shading in ("smooth", "phong", "pbr", nr.Phong(), nr.PBR(1.0, 0.1)):
        torch.testing.assert_close(nr.render(mesh, CAMERA, 32, light=None, shading=shading).rgb, plain)


def test_edges_of_corner_normals_have_the_gradient_of_their_motion():
    """A crease between two squares of one colour under a lamp: moved, it changes the image as the gradient says."""
    x = torch.tensor(0.013, dtype=torch.float32, requires_grad=True)

    def drawn(x):
        along = torch.tensor([[-1.0], [0.0], [1.0]]).repeat(1, 2).reshape(-1)
        middle = torch.tensor([0.0, 0.0, 1.0, 1.0, 0.0, 0.0])
        up = torch.tensor([-1.0, 1.0]).repeat(3)
        vertices = torch.stack((along + middle * x, up, torch.zeros(6)), -1)
        faces = torch.tensor([[0, 1, 3], [0, 3, 2], [2, 3, 5], [2, 5, 4]])
        normals = torch.tensor([[-0.6, 0.0, -0.8], [0.6, 0.0, -0.8]]).repeat_interleave(2, 0)[:, None].expand(4, 3, 3)
        mesh = nr.UVMesh(vertices, faces, torch.zeros(4, 3, 2), torch.ones(1, 1, 3), normals=normals)
        camera = nr.Camera.look_at((0.0, 0.0, -4.0), viewing_angle=10)
        light = nr.Light(0.0, 1.0, direction=(-0.6, 0.0, -0.8))
        return nr.render(mesh, camera, 32, light=light, shading="smooth", outputs=("rgb",)).rgb

    image = drawn(x)
    assert image.max() > 0.99 and 0.2 < image.min() < 0.35
    image.mean().backward()
    # The bright half loses what the dark half (0.28) gains: per unit of x, 1 / (4 tan 10° · 2) of the picture's width;
    # x grows to the left of the picture, where the bright side −x is on the right.
    across = 2 * 4 * torch.tan(torch.deg2rad(torch.tensor(10.0)))
    torch.testing.assert_close(x.grad, (1 - 0.28) / across, rtol=2e-2, atol=0)


class FacesOnly:
    def two_sided(self, corners, mirrored=False):
        return torch.ones(len(corners), 2, corners.shape[1], 3)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"shading": "gouraud"}, ValueError, "shading: expected flat, smooth, phong, pbr, or an object"),
        ({"shading": 3}, TypeError, r"shading: expected a name, Phong, PBR, …, got int"),
        ({"shading": nr.Phong}, TypeError, "shading: expected a name, Phong, PBR, …, got type"),
        ({"shading": "smooth", "light": FacesOnly()}, TypeError, "light: FacesOnly lights whole faces only"),
        ({"shading": nr.PBR(roughness=torch.ones(2))}, ValueError, "roughness: expected a batch of 1 or 1 like the"),
        ({"shading": "pbr", "light": nr.Light(direction=torch.ones(2, 3))}, ValueError, "light: expected parameters"),
        (
            {"shading": "pbr", "light": nr.EnvironmentLight(torch.ones(2, 4, 8, 3))},
            ValueError,
            "image: expected a batch",
        ),
    ],
)
def test_messages(options, error, message):
    with pytest.raises(error, match=message):
        nr.render(nr.Mesh.icosphere(1), CAMERA, 16, **options)


@pytest.mark.parametrize("shading", ["smooth", pytest.param("pbr", marks=pytest.mark.slow)])
def test_it_compiles_in_one_graph(shading):
    """The graph of a blurred environment has thousands of nodes."""
    mesh = nr.Mesh.icosphere(1)
    image, place = torch.rand(8, 16, 3), torch.tensor([1.0, 2.0, -2.0])

    def shaded(vertices, image, place):
        light = [nr.Light(), nr.SpotLight(place, 5.0, direction=(-1.0, -2.0, 2.0)), nr.EnvironmentLight(image)]
        return nr.render((vertices, mesh.faces, mesh.textures), CAMERA, 16, light=light, shading=shading).rgb

    inputs = [value.detach().clone().requires_grad_() for value in (mesh.vertices, image, place)]
    results = []
    for function in (shaded, torch.compile(shaded, fullgraph=True, backend="eager")):
        picture = function(*inputs)
        results.append((picture, *torch.autograd.grad(picture.square().sum(), inputs)))
    for plain, compiled in zip(*results, strict=True):
        torch.testing.assert_close(compiled, plain, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("layers", [None, pytest.param(2, marks=pytest.mark.slow)])
def test_materials_compile_in_one_graph(layers):
    relief = nr.Texture(torch.rand(4, 4, 3), scale=(2.0, 1.0))
    glass = {"opacity": 0.5, "alpha_mode": "BLEND", "double_sided": False}
    material = nr.Material(base_color=(1.0, 0.5, 0.2), normal_texture=relief, **glass)
    mesh = dataclasses.replace(textured(), materials=(material,))

    def shaded(vertices):
        moved = dataclasses.replace(mesh, vertices=vertices)
        return nr.render(moved, CAMERA, 16, light=LAMPS, shading="smooth", layers=layers, outputs=("rgb",)).rgb

    vertices, results = mesh.vertices.clone().requires_grad_(), []
    for function in (shaded, torch.compile(shaded, fullgraph=True, backend="eager")):
        picture = function(vertices)
        results.append((picture, *torch.autograd.grad(picture.square().sum(), vertices)))
    for plain, compiled in zip(*results, strict=True):
        torch.testing.assert_close(compiled, plain, rtol=1e-4, atol=1e-5)


def test_a_model_of_ones_own():
    """Two tones, as in a drawing."""

    class Tones:
        def shade(self, surface, albedo, lights):
            return albedo * (0.4 + 0.6 * ((surface.normals * surface.views).sum(-1, keepdim=True) > 0.7))

    image = nr.render(nr.Mesh.icosphere(3), CAMERA, 32, shading=Tones(), background=1.0, anti_aliasing=False).rgb
    assert {round(value, 4) for value in image.unique().tolist()} == {0.4, 1.0}


SHADINGS = ["flat", "smooth", "phong", "pbr", nr.Phong(0.3), nr.PBR(0.3, 0.4)]


def tinted_and_colored(vertices):
    """A white mesh with materials of two base colours, and one whose faces have these colours."""
    faces = nr.icosphere(1)[1]
    index, count = (torch.arange(80) % 3 > 0).long() - 1, len(faces)  # every third face has no material
    tint = torch.tensor([0.7, 0.3, 0.1])
    materials = (nr.Material(base_color=tint),)
    uv, ones = torch.zeros(count, 3, 2), torch.ones(count, 3, 3)
    colors = torch.where(index[:, None, None] < 0, ones, nr.linear_to_srgb(tint))
    none = torch.full((count,), -1)
    tinted = nr.UVMesh(vertices, faces, uv, none, (), ones, (), materials=materials, material_index=index)
    plain = (nr.Material(),)
    return tinted, nr.UVMesh(vertices, faces, uv, none, (), colors, (), materials=plain, material_index=index)


@pytest.mark.parametrize("layers", [None, 2])
@pytest.mark.parametrize("shading", SHADINGS)
def test_base_colors_of_materials_show_with_every_shading(shading, layers):
    """Images, and gradients to vertices through the jumps of colour between materials."""
    results = []
    for number in (0, 1):
        vertices = nr.icosphere(1)[0].requires_grad_()
        mesh = tinted_and_colored(vertices)[number]
        mesh = mesh.replace(tints=torch.ones(*mesh.faces.shape, 4))  # so that neither's colours are known at edges
        image = nr.render(mesh, CAMERA, 24, light=LAMPS, shading=shading, layers=layers, outputs=("rgb",)).rgb
        (image * torch.linspace(0, 1, 24)).sum().backward()
        results.append((image.detach(), vertices.grad))
    torch.testing.assert_close(results[0][0], results[1][0], rtol=0, atol=1e-5)
    torch.testing.assert_close(results[0][1], results[1][1], rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("shading", ["flat", "smooth", "phong", "pbr"])
def test_a_mesh_without_materials_is_the_same_beside_one_with(shading):
    tinted, colored = tinted_and_colored(nr.icosphere(1)[0])
    options = {"light": [*LAMPS, nr.EnvironmentLight(torch.rand(8, 16, 3))], "shading": shading}
    colored = dataclasses.replace(colored, materials=(), material_index=None)
    both = nr.render([tinted, colored], CAMERA, 24, **options).rgb
    for one, mesh in zip(both, (tinted, colored), strict=True):
        torch.testing.assert_close(one, nr.render(mesh, CAMERA, 24, **options).rgb[0], rtol=0, atol=1e-5)


def test_base_colors_of_a_batch_and_their_gradients():
    tinted, colored = tinted_and_colored(nr.icosphere(1)[0])
    both = nr.render([tinted, colored, tinted], CAMERA, 24).rgb
    torch.testing.assert_close(both[0], both[1], rtol=0, atol=1e-5)
    assert torch.equal(both[0], both[2])
    tint = torch.tensor([0.7, 0.3, 0.1], requires_grad=True)
    mesh = dataclasses.replace(tinted, materials=(nr.Material(base_color=tint),))
    nr.render(mesh, CAMERA, 24).rgb.sum().backward()
    assert (tint.grad > 0).all()
    assert nr.Material(base_color=tint).is_tinted and not nr.Material().is_tinted


def test_messages_name_what_does_not_fit():
    mesh = nr.Mesh.icosphere(1)
    two = nr.PointLight(torch.rand(2, 3) + 2)
    for shading in ("smooth", nr.Phong()):
        with pytest.raises(ValueError, match="light: expected parameters for 1 images or for all, got 2"):
            nr.render(mesh, CAMERA, 8, light=two, shading=shading)
    with pytest.raises(ValueError, match="shininess: expected at least 0, got -1"):
        nr.render(mesh, CAMERA, 8, shading=nr.Phong(0.5, -1.0))
    with pytest.raises(ValueError, match=r"points: expected shape \[B, …, 3\], got \[3\]"):
        nr.ShadowedLight(nr.Light(), mesh, size=8).visibility(torch.zeros(3))
    assert nr.EnvironmentLight(torch.ones(2, 4, 3)).background(CAMERA, [4, 6]).shape == (1, 3, 4, 6)
