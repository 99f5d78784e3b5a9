"""`neural-renderer run` in place of PyTorch3D: golden pictures of its tests, and formulas of its documentation.

The pictures are those of its `test_render_meshes.py` (tests/data/pytorch3d). The page `from_pytorch3d.md` has the same
scenes in this package's own terms.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.run.pytorch3d import (
    cameras,
    files,
    lighting,
    losses,
    ops,
    properties,
    rasterizer,
    shaders,
    transforms,
)
from neural_renderer.apps.run.pytorch3d.meshes import (
    Meshes,
    join_meshes_as_batch,
    join_meshes_as_scene,
    packed_to_list,
)
from neural_renderer.apps.run.pytorch3d.rasterizer import MeshRasterizer, RasterizationSettings, rasterize_meshes
from neural_renderer.apps.run.pytorch3d.stand_in import stand_in
from neural_renderer.apps.run.pytorch3d.textures import TexturesUV, TexturesVertex
from tests.paths import DATA, EXAMPLES

BLACK = shaders.BlendParams(background_color=(0.0, 0.0, 0.0))


def golden(name: str) -> Tensor:
    with Image.open(DATA / "pytorch3d" / f"test_{name}.png") as picture:
        return torch.from_numpy(np.array(picture, dtype=np.float32)) / 255


def differences(found: Tensor, name: str) -> tuple[float, float]:
    """Return the mean of absolute differences, and the share of numbers that differ by more than 0.05."""
    off = (found.detach() - golden(name)[..., : found.shape[-1]]).abs()
    return float(off.mean()), float((off > 0.05).float().mean())


def sphere(level: int = 5) -> Meshes:
    ball = ops.ico_sphere(level)
    return Meshes(ball.verts_list(), ball.faces_list(), TexturesVertex([torch.ones_like(ball.verts_packed())]))


@pytest.mark.parametrize(
    ("shader", "name", "kind"),
    [
        (shaders.HardPhongShader, "phong", cameras.FoVPerspectiveCameras),
        (shaders.HardPhongShader, "phong", cameras.FoVOrthographicCameras),
        (shaders.HardGouraudShader, "gouraud", cameras.FoVPerspectiveCameras),
        (shaders.HardFlatShader, "flat", cameras.FoVPerspectiveCameras),
    ],
)
def test_golden_spheres(shader: type, name: str, kind: type) -> None:
    """The vertices of our sphere are at other places, so flat faces and outlines differ a little."""
    R, T = cameras.look_at_view_transform(2.7, 45.0, 45.0)
    camera, lights = kind(R=R, T=T), lighting.PointLights(location=[[0.0, 0.0, 2.0]])
    draw = shaders.MeshRenderer(
        MeshRasterizer(camera, RasterizationSettings(image_size=512)),
        shader(cameras=camera, lights=lights, blend_params=BLACK),
    )
    mean, share = differences(draw(sphere())[0, ..., :3], f"simple_sphere_light_{name}_elevated_{kind.__name__}")
    assert mean < 0.003 and share < 0.001


@pytest.mark.parametrize(("side", "azimuth", "z"), [("front", 180.0, -2.0), ("back", 0.0, 2.0)])
def test_golden_cow(side: str, azimuth: float, z: float) -> None:
    """A file with its image, blended softly, as PyTorch3D's tutorial on textured meshes."""
    mesh = files.load_objs_as_meshes([EXAMPLES / "data" / "spot.obj"])
    R, T = cameras.look_at_view_transform(2.7, 0, azimuth)
    camera, lights = cameras.FoVPerspectiveCameras(R=R, T=T), lighting.PointLights(location=[[0.0, 0.0, z]])
    shader = shaders.SoftPhongShader(cameras=camera, lights=lights)
    draw = shaders.MeshRenderer(MeshRasterizer(camera, RasterizationSettings(image_size=512)), shader)
    mean, share = differences(draw(mesh)[0, ..., :3], f"texture_map_{side}_MeshRasterizer")
    assert mean < 0.0012 and share < 0.001


def brute(corners: Tensor, size: tuple[int, int], radius: float, count: int, perspective: bool, clip: bool):
    """Rasterise by the documented rules, one face at a time in float64: faces, depths, weights and distances."""
    height, width = size
    short = min(size)
    x, y = ((side - 1 - 2 * torch.arange(side).double()) / short for side in (width, height))
    points = torch.stack((x.expand(height, width), y[:, None].expand(height, width)), -1)
    rows = []
    for number, face in enumerate(corners.double()):
        flat, z = face[:, :2], face[:, 2]
        inverse = torch.linalg.inv(torch.cat((flat, torch.ones(3, 1).double()), 1))
        weights = torch.cat((points, torch.ones(height, width, 1).double()), -1) @ inverse
        if perspective:
            weights = weights / z
            weights = weights / weights.sum(-1, keepdim=True)
        inside = (weights > 0).all(-1)
        along = flat.roll(-1, 0) - flat
        arm = points[..., None, :] - flat
        share = ((arm * along).sum(-1) / along.square().sum(-1)).clamp(0, 1)
        distance = (arm - share[..., None] * along).square().sum(-1).amin(-1)
        if clip:
            weights = weights.clamp(min=0) / weights.clamp(min=0).sum(-1, keepdim=True)
        depth = (weights * z).sum(-1)
        kept = (inside | (distance < radius)) & (depth >= 0)
        signed = torch.where(inside, -distance, distance)
        rows.append((torch.where(kept, depth, torch.inf), torch.full(size, number), depth, weights, signed))
    key, numbers, depth, weights, distance = (torch.stack(each) for each in zip(*rows, strict=True))
    order = key.argsort(dim=0, stable=True)[:count]
    missing = key.gather(0, order).isinf()
    chosen = [each.gather(0, order).masked_fill(missing, -1).movedim(0, -1) for each in (numbers, depth, distance)]
    bary = weights.gather(0, order[..., None].expand(-1, -1, -1, 3)).masked_fill(missing[..., None], -1)
    return chosen[0], chosen[1], bary.movedim(0, -2), chosen[2]


@pytest.mark.parametrize("size", [(24, 24), (18, 30), (30, 18)])
@pytest.mark.parametrize(
    ("radius", "perspective", "clip"), [(0.0, False, False), (0.0, True, False), (0.01, True, True)]
)
def test_rasterize_meshes(size: tuple[int, int], radius: float, perspective: bool, clip: bool) -> None:
    """x to the left, packed indices, depths, weights, distances, and K layers, in two meshes of different sizes."""
    random = torch.Generator().manual_seed(1)
    corners = torch.rand(9, 3, 3, generator=random) * torch.tensor([2.4, 2.4, 2.0]) + torch.tensor([-1.2, -1.2, 1.0])
    meshes = Meshes(
        [corners[:5].reshape(-1, 3), corners[5:].reshape(-1, 3)],
        [torch.arange(15).view(-1, 3), torch.arange(12).view(-1, 3)],
    )
    found = rasterize_meshes(meshes, size, radius, 3, perspective_correct=perspective, clip_barycentric_coords=clip)
    for image, (first, part) in enumerate(((0, corners[:5]), (5, corners[5:]))):
        faces, *values = brute(part, size, radius, 3, perspective, clip)
        faces = torch.where(faces < 0, -1, faces + first)
        same = found[0][image] == faces
        assert same.float().mean() > 0.999  # a centre on an edge
        for value, expected in zip(found[1:], values, strict=True):
            torch.testing.assert_close(value[image][same].double(), expected[same], rtol=1e-3, atol=1e-4)


def test_gradients_reach_vertices() -> None:
    corners = torch.tensor([[[-0.7, -0.6, 1.0], [0.8, -0.5, 1.5], [0.1, 0.9, 2.0]]], dtype=torch.float32)

    def total(points: Tensor, which: int) -> Tensor:
        mesh = Meshes([points.view(3, 3)], [torch.arange(3)[None]])
        return rasterize_meshes(mesh, 8, 1e-3, 2, perspective_correct=True, clip_barycentric_coords=True)[which].sum()

    for which in (1, 2, 3):
        points = corners.clone().requires_grad_()
        [grad] = torch.autograd.grad(total(points, which), points)
        step = torch.zeros_like(corners)
        step[0, 1, 0] = 1e-3
        change = (total(corners + step, which) - total(corners - step, which)) / 2e-3
        assert abs(float(grad[0, 1, 0] - change)) < 0.02 * max(1.0, abs(float(change)))


def test_faces_that_face_away_and_come_near() -> None:
    triangle = torch.tensor([[0.9, -0.9, 2.0], [-0.9, -0.9, 2.0], [0.0, 0.9, 2.0]])  # counter-clockwise in the image
    for faces, seen in ((torch.tensor([[0, 1, 2]]), True), (torch.tensor([[0, 2, 1]]), False)):
        for radius in (0.0, 1e-6):
            found = rasterize_meshes(Meshes([triangle], [faces]), 9, radius, 1, cull_backfaces=True)[0]
            assert bool((found >= 0).any()) is seen
    near = rasterize_meshes(Meshes([triangle], [torch.tensor([[0, 1, 2]])]), 9, 0.0, 1, z_clip_value=2.5)
    assert (near[0] < 0).all() and (near[1] == -1).all()


def test_blending() -> None:
    """SoftRas' formulas, pixel by pixel."""
    fragments = rasterizer.Fragments(
        torch.tensor([[[[4, 7, -1]]]]), torch.tensor([[[[2.0, 3.0, -1.0]]]]), torch.rand(1, 1, 1, 3, 3),
        torch.tensor([[[[1e-4, -2e-4, -1.0]]]]),
    )  # fmt: skip
    colors, blend = torch.rand(1, 1, 1, 3, 3), shaders.BlendParams(1e-4, 0.1, (0.2, 0.4, 0.6))
    cover = [1 / (1 + math.exp(1)), 1 / (1 + math.exp(-2))]
    alpha = 1 - (1 - cover[0]) * (1 - cover[1])
    found = shaders.softmax_rgb_blend(colors, fragments, blend, 1.0, 100.0)[0, 0, 0]
    z = [(100 - depth) / 99 for depth in (2.0, 3.0)]
    weights = [share * math.exp((near - z[0]) / 0.1) for share, near in zip(cover, z, strict=True)]
    behind = max(math.exp((1e-10 - z[0]) / 0.1), 1e-10)
    total = weights[0] * colors[0, 0, 0, 0] + weights[1] * colors[0, 0, 0, 1] + behind * torch.tensor([0.2, 0.4, 0.6])
    torch.testing.assert_close(found[:3], total / (sum(weights) + behind))
    assert abs(float(found[3]) - alpha) < 1e-6
    assert abs(float(shaders.sigmoid_alpha_blend(colors, fragments, blend)[0, 0, 0, 3]) - alpha) < 1e-6


def test_silhouettes_are_those_of_soft_silhouettes() -> None:
    R, T = cameras.look_at_view_transform(2.7, 10.0, 20.0)
    camera, ball = cameras.FoVPerspectiveCameras(R=R, T=T), ops.ico_sphere(2)
    settings = RasterizationSettings(48, blur_radius=math.log(1e4 - 1) * 1e-4, faces_per_pixel=60)
    draw = shaders.MeshRenderer(MeshRasterizer(camera, settings), shaders.SoftSilhouetteShader())
    eye = nr.get_points_from_angles(2.7, 10.0, 160.0)
    corners = nr.vertices_to_faces(nr.Camera.look_at(eye, fov=60)(ball.verts_packed()), ball.faces_packed())
    torch.testing.assert_close(draw(ball)[..., 3], nr.soft_silhouettes(corners, 48), rtol=0, atol=2e-3)


def test_batches_of_soft_shaders() -> None:
    """Images of a batch are those of its meshes alone, also of one that no pixel shows."""
    balls = [sphere(1), sphere(2).scale_verts(0.3), sphere(0).offset_verts(torch.tensor([[0.0, 90.0, 0.0]]))]
    R, T = cameras.look_at_view_transform(2.7, 10.0, 20.0)
    camera, settings = cameras.FoVPerspectiveCameras(R=R, T=T), RasterizationSettings((12, 20), 0.01, 9)
    for shader in (shaders.SoftPhongShader(cameras=camera), shaders.SoftSilhouetteShader()):
        draw = shaders.MeshRenderer(MeshRasterizer(camera, settings), shader)
        together = draw(join_meshes_as_batch(balls))
        torch.testing.assert_close(together, torch.cat([draw(each) for each in balls]))
        assert together[0, ..., 3].amax() > 0.9 > 0 == together[2, ..., 3].amax()


def test_cameras() -> None:
    """Row vectors times R, plus T; the page's own camera projects to the same pixels."""
    R, T = cameras.look_at_view_transform(torch.tensor([2.0, 3.0]), 20.0, torch.tensor([30.0, -70.0]))
    points, size = torch.rand(2, 7, 3) - 0.5, ((48, 64),)
    fov = cameras.FoVPerspectiveCameras(R=R, T=T, fov=50.0)
    assert len(fov) == 2 and len(fov[0]) == 1 and fov.get_camera_center().norm(dim=1).allclose(torch.tensor([2.0, 3.0]))
    view = fov.get_world_to_view_transform().transform_points(points)
    torch.testing.assert_close(view, points @ R + T[:, None])
    ndc = fov.transform_points_ndc(points)
    focal = 1 / math.tan(math.radians(25))
    torch.testing.assert_close(ndc[..., :2], focal * view[..., :2] / view[..., 2:])
    torch.testing.assert_close(ndc[..., 2], (100 / 99) * (1 - 1 / view[..., 2]), rtol=1e-4, atol=1e-4)
    pixels = fov.transform_points_screen(points, image_size=size)
    torch.testing.assert_close(pixels[..., :2], torch.tensor([32.0, 24.0]) - 24 * ndc[..., :2])
    depth = view[..., 2:]
    back = fov.unproject_points(torch.cat((ndc[..., :2], depth), -1))
    torch.testing.assert_close(back, points, rtol=1e-3, atol=1e-3)
    K = torch.tensor([[[60.0, 0, 30], [0, 55, 20], [0, 0, 1]]])
    for turn in (1.0, 2.0):
        own = nr.rotations.from_axis_angle(torch.tensor([[0.1, turn, 0.2]]))
        tvec = torch.tensor([[0.1, -0.2, 4.0]])
        theirs = cameras.cameras_from_opencv_projection(own, tvec, K, torch.tensor([[48, 64]]))
        expected, _ = nr.Camera.projection(K, own, tvec, orig_size=(48, 64)).project(points[0], (48, 64))
        found = theirs.transform_points_screen(points[:1], image_size=size)[..., :2]
        torch.testing.assert_close(found, expected, rtol=1e-3, atol=1e-3)
        in_pixels = cameras.PerspectiveCameras(
            K[:, [0, 1], [0, 1]], K[:, :2, 2], theirs.R, theirs.T, in_ndc=False, image_size=size
        )
        again = in_pixels.transform_points_screen(points[:1])[..., :2]
        torch.testing.assert_close(again, expected, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("elevation", [90.0, -90.0])
def test_cameras_that_look_along_up(elevation: float) -> None:
    """They are turned as the rounding of their position says, and keep three axes."""
    R, _ = cameras.look_at_view_transform(1.0, elevation, torch.tensor([0.0, 90.0]))
    torch.testing.assert_close(R @ R.transpose(1, 2), torch.eye(3).expand(2, 3, 3), rtol=0, atol=1e-5)


class OwnLights(properties.TensorProperties):
    """As programs derive lights of their own."""

    def __init__(self, color: object = ((0.5, 0.5, 0.5),), device: str = "cpu") -> None:
        super().__init__(color=color, device=device)

    def clone(self) -> object:
        return super().clone(self.__class__(device=self.device))


def test_properties() -> None:
    lights = OwnLights(torch.rand(2, 3))
    assert len(lights) == 2 and torch.equal(lights.clone().color, lights.color)
    one, other = properties.convert_to_tensors_and_broadcast(2, torch.rand(3, 1))
    assert one.tolist() == [2.0] * 3 and other.shape == (3, 1)


def test_transforms() -> None:
    R, points = nr.rotations.from_axis_angle(torch.tensor([[0.3, -0.4, 0.5]])), torch.rand(5, 3)
    moved = transforms.Rotate(R).compose(transforms.Translate(1.0, 2.0, 3.0)).scale(2.0).transform_points(points)
    torch.testing.assert_close(moved, 2 * (points @ R[0] + torch.tensor([1.0, 2.0, 3.0])))
    angles = torch.tensor([0.1, 0.2, 0.3])
    x, y, z = (transforms.RotateAxisAngle(float(a), axis, degrees=False) for a, axis in zip(angles, "XYZ", strict=True))
    matrix = transforms.euler_angles_to_matrix(angles, "XYZ")
    torch.testing.assert_close(z.compose(y, x).get_matrix()[0, :3, :3].T, matrix)
    torch.testing.assert_close(transforms.matrix_to_rotation_6d(R), R[:, :2].flatten(1))
    torch.testing.assert_close(transforms.rotation_6d_to_matrix(R[:, :2].flatten(1)), R)
    turns = transforms.random_rotations(4)
    torch.testing.assert_close(turns @ turns.transpose(1, 2), torch.eye(3).expand(4, 3, 3))


def test_meshes() -> None:
    ball, cube = ops.ico_sphere(0), nr.cube()
    meshes = Meshes([ball.verts_packed(), cube[0]], [ball.faces_packed(), cube[1]])
    assert meshes.verts_padded().shape == (2, 12, 3) and meshes.faces_padded()[1, 12:].eq(-1).all()
    assert meshes.faces_packed()[20:].amin() == 12 and meshes.verts_packed_to_mesh_idx().sum() == 8
    assert torch.equal(Meshes(meshes.verts_padded(), meshes.faces_padded()).faces_list()[1], cube[1].long())
    assert (
        meshes.edges_packed().shape == (30 + 18, 2) and abs(float(meshes.faces_areas_packed()[20:].sum()) - 24) < 1e-4
    )
    offset = torch.rand(20, 3, requires_grad=True)
    moved = meshes.offset_verts(offset).scale_verts(2.0)
    moved.verts_packed().sum().backward()
    assert offset.grad.eq(2).all() and torch.equal(meshes[1].verts_packed(), cube[0])
    assert len(meshes.extend(3)) == 6 and len(join_meshes_as_batch([meshes, ball])) == 3
    assert join_meshes_as_scene(meshes).faces_packed().amax() == 19
    edges = meshes.edges_packed()[meshes.faces_packed_to_edges_packed()]  # each lies across from its corner
    together = torch.cat((edges, meshes.faces_packed()[..., None]), 2).sort(-1).values
    assert torch.equal(together, meshes.faces_packed().sort(1).values[:, None].expand(-1, 3, -1))
    rows = torch.tensor([[1.0, 2.0, 3.0], [2.0, 2.0, 2.0], [9.0, 9.0, 9.0]])  # a program gives one for each vertex
    assert torch.equal(meshes.scale_verts(rows).verts_list()[0], ball.verts_packed() * rows[0])
    assert [len(part) for part in packed_to_list(meshes.verts_packed(), meshes.num_verts_per_mesh())] == [12, 8]
    normals = ball.verts_normals_packed()
    torch.testing.assert_close(normals, ball.verts_packed(), rtol=0, atol=1e-5)


def test_losses_and_samples() -> None:
    x, y = torch.rand(2, 40, 3, requires_grad=True), torch.rand(2, 30, 3)
    square = torch.cdist(x, y).square()
    loss, none = losses.chamfer_distance(x, y)
    torch.testing.assert_close(loss, square.amin(2).mean() + square.amin(1).mean())
    loss.backward()
    assert none is None and x.grad.any()
    meshes = Meshes([nr.cube()[0], 2 * nr.cube()[0]], [nr.cube()[1]] * 2)
    # 12 edges of length 2 and 6 diagonals, in two sizes.
    torch.testing.assert_close(losses.mesh_edge_loss(meshes), torch.tensor((1 + 4) / 2 * (12 * 4 + 6 * 8) / 18))
    torch.testing.assert_close(losses.mesh_normal_consistency(meshes), torch.tensor(12 / 18))
    points, normals = ops.sample_points_from_meshes(meshes, 50, return_normals=True)
    assert points.shape == normals.shape == (2, 50, 3) and ((points[0] * normals[0]).sum(-1) - 1).abs().max() < 1e-5
    with pytest.raises(NotImplementedError, match=r"mesh_laplacian_smoothing\(method='cot'\)"):
        losses.mesh_laplacian_smoothing(meshes, "cot")


def test_files(tmp_path: Path) -> None:
    verts, faces, more = files.load_obj(EXAMPLES / "data" / "spot.obj")
    assert verts.shape[1] == 3 and faces.verts_idx.shape == faces.textures_idx.shape and len(more.texture_images) == 1
    image = next(iter(more.texture_images.values()))
    files.save_obj(
        str(tmp_path / "a.obj"), verts, faces.verts_idx,
        verts_uvs=more.verts_uvs, faces_uvs=faces.textures_idx, texture_map=image,
    )  # fmt: skip
    again = files.load_objs_as_meshes([tmp_path / "a.obj"])
    assert torch.equal(again.verts_packed(), verts) and torch.equal(again.faces_packed(), faces.verts_idx)
    assert isinstance(again.textures, TexturesUV)
    files.save_ply(str(tmp_path / "a.ply"), verts, faces.verts_idx)
    assert all(map(torch.equal, files.load_ply(tmp_path / "a.ply"), (verts, faces.verts_idx)))


def test_texture_coordinates() -> None:
    """0 and 1 are the centres of the outermost pixels, v is up, as documented for ``align_corners=True``."""
    image = torch.rand(5, 9, 3)
    textures = TexturesUV([image], [torch.tensor([[0, 1, 2]])], [torch.tensor([[0.25, 0.75], [1.0, 0.0], [0.0, 1.0]])])
    corners = torch.eye(3).view(1, 1, 3, 1, 3)
    fragments = rasterizer.Fragments(torch.zeros(1, 1, 3, 1).long(), corners, corners, corners)
    found = textures.sample_textures(fragments)[0, 0, :, 0]
    torch.testing.assert_close(found, torch.stack((image[1, 2], image[4, 8], image[0, 0])))
    torch.testing.assert_close(textures.faces_verts_textures_packed()[0], found)
    textures._num_faces_per_mesh = [5]  # some programs set it beside the tensors
    assert textures._num_faces_per_mesh == [1]


PROGRAM = """
import torch
import pytorch3d.renderer.mesh.rasterize_meshes
from pytorch3d.io import load_obj
from pytorch3d.renderer import PointsRasterizer, TexturesVertex, blending, look_at_view_transform
from pytorch3d.renderer.mesh import rasterize_meshes
from pytorch3d.structures import Meshes
from pytorch3d.vis.plotly_vis import plot_scene

verts = torch.tensor([[[0.5, -0.5, 11.0], [-0.5, -0.5, 11.0], [0.0, 0.5, 11.0]]], device="cuda")
found = rasterize_meshes(Meshes(verts, torch.tensor([[[0, 1, 2]]])), 16, faces_per_pixel=1, perspective_correct=False)
assert blending.BlendParams is pytorch3d.renderer.BlendParams
print(tuple(found[0].shape), int((found[0] >= 0).sum()) > 20)
PointsRasterizer()
"""


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setattr(sys, "argv", sys.argv)
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "fit.py").write_text(PROGRAM)
    yield tmp_path / "fit.py"


def test_a_program_imports_it(program: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What is not there can be imported, and raises an error that names it when it is called."""
    assert cli.main(["run", "--device", "cpu", "--ours", str(program)]) == 1
    found = capsys.readouterr()
    assert found.out == "(1, 16, 16, 1) True\n", found.err
    assert "NotImplementedError: pytorch3d.renderer.PointsRasterizer: neural-renderer run stands in" in found.err
    assert not any(name.startswith("pytorch3d") for name in sys.modules)


@pytest.mark.parametrize("installed", [False, True])
def test_the_installed_package_stands(installed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if installed:
        (tmp_path / "pytorch3d").mkdir()
        (tmp_path / "pytorch3d" / "__init__.py").write_text("NAME = 'theirs'\n")
        monkeypatch.syspath_prepend(tmp_path)
    try:
        with stand_in():
            import pytorch3d
        assert (getattr(pytorch3d, "NAME", None) == "theirs") is installed
    finally:
        sys.modules.pop("pytorch3d", None)
