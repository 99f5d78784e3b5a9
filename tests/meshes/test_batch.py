"""Meshes of different size in one batch, and several in one scene."""

from __future__ import annotations

import re

import pytest
import torch

import neural_renderer as nr
from tests.paths import ROOT
from tests.rounding import rounding


def shapes(device):
    ball = nr.Mesh.icosphere(2, radius=0.5).to(device)
    vertices, faces = nr.cube()
    generator = torch.Generator().manual_seed(0)
    box = nr.Mesh(0.5 * vertices, faces, torch.rand(len(faces), 2, 2, 2, 3, generator=generator)).to(device)
    ball = nr.Mesh(ball.vertices, ball.faces, torch.ones(len(ball.faces), 2, 2, 2, 3, device=device))
    return ball.trainable(), box.trainable()


@pytest.mark.parametrize("gradient", ["nmr", "edge"])
def test_a_list_is_drawn_as_each_mesh_alone(device, gradient):
    meshes = list(shapes(device))
    camera = nr.Camera.look_at([[0.3, 1.0, -2.5], [1.5, 0.2, -2.0]], viewing_angle=30).to(device)
    together = nr.render(meshes, camera, 48, gradient=gradient)
    weight = torch.randn(2, 3, 48, 48, generator=torch.Generator().manual_seed(1)).to(device)
    found = torch.autograd.grad((together.rgb * weight).sum(), [m.vertices for m in meshes])
    for b, mesh in enumerate(meshes):
        own = nr.Camera.look_at([[0.3, 1.0, -2.5], [1.5, 0.2, -2.0]][b], viewing_angle=30).to(device)
        alone = nr.render(mesh, own, 48, gradient=gradient)
        for name in ("rgb", "alpha", "depth"):  # the cameras' products are taken in another order; depth is up to 100
            torch.testing.assert_close(getattr(together, name)[b], getattr(alone, name)[0], **rounding(64, 100))
        (expected,) = torch.autograd.grad((alone.rgb[0] * weight[b]).sum(), mesh.vertices)
        # Where an edge passes near a pixel's centre, the pull has this distance in its denominator.
        assert (found[b] - expected).norm() <= 1e-3 * expected.norm()


def test_one_scene(device):
    ball, box = shapes(device)
    vertices, faces, textures = nr.join([ball, box])
    assert faces.amin() == 0 and faces.amax() == len(vertices) - 1
    camera = nr.Camera.look_at((0.3, 1.0, -2.5), viewing_angle=30).to(device)
    alpha = nr.render((vertices, faces, textures), camera, 48, outputs="alpha").alpha
    single = [nr.render(mesh, camera, 48, outputs="alpha").alpha for mesh in (ball, box)]
    assert torch.equal(alpha, torch.maximum(*single))
    alpha.sum().backward()
    assert ball.vertices.grad.any() or box.vertices.grad.any()


def test_no_face_is_minus_one_three_times(device):
    vertices, faces = (t.to(device) for t in nr.icosphere(1))
    camera = nr.Camera.look_at((0.0, 1.0, -2.5), viewing_angle=30).to(device)
    filled = torch.cat((faces, faces.new_full((3, 3), -1)))
    expected = nr.render((vertices, faces), camera, 32, outputs="alpha").alpha
    assert torch.equal(nr.render((vertices, filled), camera, 32, outputs="alpha").alpha, expected)
    filled[-1] = torch.tensor([0, 1, -1])
    with pytest.raises(ValueError, match="faces: expected indices in"):
        nr.render((vertices, filled), camera, 32, outputs="alpha")


def test_what_does_not_fit(device):
    ball, box = shapes(device)
    with pytest.raises(TypeError, match="meshes: expected a list of Mesh, or of UVMesh, got"):
        nr.batch([ball, box.vertices])
    with pytest.raises(ValueError, match="meshes: expected at least one Mesh"):
        nr.join([])
    with pytest.raises(ValueError, match="meshes: expected textures of one size, got 2 and 4"):
        nr.batch([ball, nr.Mesh.icosphere(1, texture_size=4).to(device)])


def painted(device, seed: int, sides: tuple[int, int], normals: bool = False) -> nr.UVMesh:
    """A mesh whose faces have one of two images, or colours."""
    generator = torch.Generator().manual_seed(seed)
    vertices, faces = nr.cube() if seed % 2 else nr.icosphere(1)
    count = len(faces)
    mesh = nr.UVMesh(
        0.6 * vertices,
        faces,
        torch.rand(count, 3, 2, generator=generator),
        torch.arange(count) % 3 - 1,
        tuple(torch.rand(side, 8, 3, generator=generator) for side in sides),
        torch.rand(count, 3, 3, generator=generator),
        ("repeat", "clamp"),
        materials=(nr.Material(metallic=seed / 10),),
        normals=torch.nn.functional.normalize(vertices[faces.long()], dim=-1) if normals else None,
    )
    return mesh.to(device)


@pytest.mark.parametrize("gradient", ["nmr", "edge"])
def test_a_list_of_uv_meshes_is_drawn_as_each_mesh_alone(device, gradient):
    first, second = painted(device, 0, (16, 4)), painted(device, 1, (8, 32)).trainable()
    meshes = [first.trainable("vertices", "images", "colors"), second]
    eyes = [[0.3, 1.0, -2.5], [1.5, 0.2, -2.0]]
    camera = nr.Camera.look_at(eyes, viewing_angle=30).to(device)
    together = nr.render(meshes, camera, 48, gradient=gradient)
    weight = torch.randn(2, 3, 48, 48, generator=torch.Generator().manual_seed(1)).to(device)
    leaves = [list(mesh.parameters()) for mesh in meshes]
    assert [len(own) for own in leaves] == [4, 4]
    found = torch.autograd.grad((together.rgb * weight).sum(), [part for own in leaves for part in own])
    for b, mesh in enumerate(meshes):
        alone = nr.render(mesh, nr.Camera.look_at(eyes[b], viewing_angle=30).to(device), 48, gradient=gradient)
        for name in ("rgb", "alpha", "depth"):
            torch.testing.assert_close(getattr(together, name)[b], getattr(alone, name)[0], **rounding(64, 100))
        expected = torch.autograd.grad((alone.rgb[0] * weight[b]).sum(), leaves[b])
        for mine, theirs in zip(found[4 * b : 4 * b + 4], expected, strict=True):
            assert (mine - theirs).norm() <= 1e-3 * theirs.norm()
    fragments = nr.fragments(meshes, camera, 48)
    assert fragments.face_index.shape == (2, 96, 96)
    assert nr.batch(meshes).shade(fragments).shape == (2, 96, 96, 3)
    one = nr.batch(meshes[:1])
    both = nr.render(one, camera, 48)
    torch.testing.assert_close(both.rgb[0], nr.render(meshes[0], camera[0], 48).rgb[0], **rounding(64, 1))


def test_uv_meshes_in_one_scene(device):
    first, second = painted(device, 0, (16, 4)), painted(device, 1, (8, 32), normals=True)
    shared = nr.UVMesh(**{**vars(first), "images": (first.images[0], second.images[1]), "wraps": ("repeat", "clamp")})
    scene = nr.join([first, second, shared])
    assert scene.num_faces == first.num_faces + second.num_faces + shared.num_faces
    assert len(scene.images) == 4 and len(scene.materials) == 2  # what meshes share appears once
    assert scene.materials[int(scene.material_index[first.num_faces])].metallic.item() == pytest.approx(0.1)
    start = first.num_faces
    assert torch.equal(scene.normals[start : start + second.num_faces], second.normals)
    torch.testing.assert_close(scene.normals[:start].norm(dim=-1), torch.ones_like(scene.normals[:start, :, 0]))
    camera = nr.Camera.look_at((0.3, 1.0, -2.5), viewing_angle=30).to(device)
    alone = nr.render(second, camera, 48, anti_aliasing=False)
    kept = scene.submesh(range(start, start + second.num_faces))
    torch.testing.assert_close(nr.render(kept, camera, 48, anti_aliasing=False).rgb, alone.rgb, **rounding(64, 1))
    plain = nr.UVMesh(*nr.cube(), torch.rand(8, 2), torch.rand(4, 4, 3)).to(device)
    joined = nr.join([plain, plain])
    assert len(joined.images) == 1 and joined.materials == () and joined.material_index is None


def test_what_does_not_fit_together(device):
    ball, flat = nr.Mesh.icosphere(1).to(device), painted(device, 0, (4, 4))
    camera = nr.Camera.look_at((0.3, 1.0, -2.5)).to(device)
    for call in (nr.batch, nr.join, lambda several: nr.render(several, camera), lambda s: nr.fragments(s, camera)):
        with pytest.raises(TypeError, match=r"meshes: expected all of one kind, got Mesh and UVMesh; Mesh\.load, or"):
            call([ball, flat])
    with pytest.raises(ValueError, match=r"meshes\[1\]: expected one mesh, got a batch"):
        nr.join([flat, nr.batch([flat, flat])])


@pytest.mark.parametrize("shading", ["smooth", "phong", "pbr"])
def test_a_list_is_shaded_as_each_mesh_alone(shading):
    """With materials, textures of materials, normal maps, normals of the file, and normals computed."""
    generator = torch.Generator().manual_seed(0)
    bump = nr.Texture(0.5 + torch.rand(8, 8, 3, generator=generator) / 2)
    rough = nr.Material(roughness=0.4, metallic=0.5, specular=(0.3, 0.2, 0.1), normal_texture=bump)
    first, second = painted("cpu", 0, (16, 4), normals=True), painted("cpu", 1, (8, 32))
    second = nr.UVMesh(**{**vars(second), "materials": (rough, nr.Material(emissive=(0.1, 0.2, 0.0)))})
    second = nr.UVMesh(**{**vars(second), "material_index": torch.arange(12) % 3 - 1})
    camera = nr.Camera.look_at([[0.3, 1.0, -2.5], [1.5, 0.2, -2.0]], viewing_angle=30)
    light = nr.Light(ambient=[0.2, 0.5], directional=torch.tensor([0.8, 0.3]), direction=[[0.0, 1, -1], [1.0, 1, -1]])
    together = nr.render([first, second], camera, 48, shading=shading, light=light)
    for b, mesh in enumerate([first, second]):
        own = nr.Light((0.2, 0.5)[b], (0.8, 0.3)[b], direction=((0.0, 1, -1), (1.0, 1, -1))[b])
        alone = nr.render(mesh, camera[b], 48, shading=shading, light=own)
        torch.testing.assert_close(together.rgb[b], alone.rgb[0], rtol=1e-4, atol=1e-4)


def test_layers_of_a_list_are_those_of_each_mesh():
    glass = nr.Material(opacity=0.4, alpha_mode="BLEND")
    meshes = [nr.UVMesh(**{**vars(painted("cpu", seed, (8, 4))), "materials": (glass,)}) for seed in (0, 1)]
    camera = nr.Camera.look_at([[0.3, 1.0, -2.5], [1.5, 0.2, -2.0]], viewing_angle=30)
    together = nr.render(meshes, camera, 32, layers=2)
    for b, mesh in enumerate(meshes):
        alone = nr.render(mesh, camera[b], 32, layers=2)
        for name in ("rgb", "alpha"):
            torch.testing.assert_close(getattr(together, name)[b], getattr(alone, name)[0], rtol=1e-4, atol=1e-4)
    with pytest.raises(ValueError, match="outputs: expected some of rgb, alpha, depth with layers, got normal"):
        nr.render(meshes, camera, 8, layers=2, outputs=("rgb", "normal"))


def test_the_rows_of_the_page_on_batches_run():
    page = ROOT / "docs" / "guides" / "batches.md"
    if not page.is_file():
        pytest.skip("the documentation is not here")
    camera = nr.Camera.look_at([[0.3, 1.0, -2.5], [1.5, 0.2, -2.0]], viewing_angle=30)
    ball, faces = nr.icosphere(1)
    mesh1, mesh2 = nr.Mesh(ball, faces), nr.Mesh(*nr.cube())
    given = {"nr": nr, "mesh": mesh1, "mesh1": mesh1, "mesh2": mesh2, "faces": faces}
    given["vertices"] = torch.stack((ball, 0.5 * ball))
    row = r"^\| (.*) \| `(nr\.render.*?)`.* \| (B|1|one for each) \|$"
    rows = re.findall(row, page.read_text("utf-8"), re.MULTILINE)
    assert len(rows) == 4
    for what, code, count in rows:
        cameras = camera[:1] if "one camera" in what or count == "1" else camera
        images = eval(code, {**given, "camera": cameras})
        assert len(images.rgb) == (1 if count == "1" else 2), what
    white = nr.render((ball, faces), camera, 32).rgb
    torch.testing.assert_close(white, nr.render(mesh1, camera, 32).rgb, **rounding(64, 1))
    assert white.max() > 0.5 and len(nr.render((given["vertices"], faces), camera, 32).rgb) == 2
    assert nr.render((ball, faces), camera, 32, shading="smooth").rgb.max() > 0.5


@pytest.mark.parametrize("colors", ["textures", "vertex_colors", "face_colors"])
@pytest.mark.parametrize("light", [None, nr.Light()])
def test_a_list_draws_and_differentiates_each_mesh_as_a_call_of_its_own(light, colors):
    generator = torch.Generator().manual_seed(0)
    shapes = [nr.icosphere(2), nr.cube(), nr.icosphere(0)]
    meshes = []
    for size, (vertices, faces) in enumerate(shapes, 1):
        count = len(vertices if colors == "vertex_colors" else faces)
        values = torch.rand(count, *((3, 3, 3) if colors == "textures" else ()), 3, generator=generator)
        meshes.append(nr.Mesh(vertices, faces, texture_size=size, **{colors: values}).trainable())
    cameras = nr.Camera.look_at(
        nr.get_points_from_angles(4.0, 30.0, torch.tensor([0.0, 50.0, 200.0])), viewing_angle=30
    )
    weight = torch.rand(3, 3, 32, 32, generator=generator)

    def gradients(draw):
        for mesh in meshes:
            mesh.zero_grad()
        rgb = draw()
        (rgb * weight).sum().backward()
        return rgb.detach(), [part.grad.clone() for mesh in meshes for part in mesh.parameters()]

    together = gradients(lambda: nr.render(meshes, cameras, 32, light=light).rgb)
    alone = gradients(lambda: torch.cat([nr.render(m, cameras[i], 32, light=light).rgb for i, m in enumerate(meshes)]))
    assert torch.equal(together[0], alone[0])
    for one, other in zip(together[1], alone[1], strict=True):
        assert one.abs().max() > 0
        torch.testing.assert_close(one, other)


def test_a_list_of_cubes_and_colours_of_vertices_is_baked():
    (vertices, faces), camera = nr.icosphere(1), nr.Camera.look_at([[0.0, 1.0, -2.5], [1.0, 1.0, -2.0]])
    colored = nr.Mesh(vertices, faces, vertex_colors=vertices.abs(), texture_size=2).trainable("vertex_colors")
    cubes = nr.Mesh.icosphere(2, texture_size=2)
    found = nr.render([colored, cubes], camera, 32).rgb
    baked = nr.Mesh(vertices, faces, colored.cubes().detach())
    assert torch.equal(found, nr.render([baked, cubes], camera, 32).rgb)
    found.sum().backward()
    assert colored.vertex_colors.grad.any()
    with pytest.raises(ValueError, match="meshes: expected textures of one size, got 2 and 4"):
        nr.render([colored, nr.Mesh.icosphere(1)], camera, 32)
