"""The page for users of PyTorch3D: each row shows what PyTorch3D shows.

Formulas are from its documentation, written here in float64 and by brute force. Golden pictures are those of its test
`test_render_meshes.py` (tests/data/pytorch3d).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor
from torch.nn.functional import avg_pool2d, normalize, relu

import neural_renderer as nr
from tests.coming_from.pages import Page, needs_pages, same_but_at_edges
from tests.paths import DATA, EXAMPLES
from tests.rounding import STEP, rounding

pytestmark = needs_pages
PAGE = Page("from_pytorch3d.md")
FOCAL = 1 / math.tan(math.radians(30))  # of fov=60
AT_EDGES = 0.01


def golden(name: str) -> Tensor:
    """Read a golden picture of PyTorch3D's tests, [H, W] or [H, W, 3]."""
    with Image.open(DATA / "pytorch3d" / f"test_{name}.png") as picture:
        return torch.from_numpy(np.array(picture)).double() / 255


def view(dist: float, elev: float, azim: float) -> tuple[Tensor, Tensor]:
    """R and T of `look_at_view_transform`: points are rows, multiplied from the right; x to the left, y up."""
    e, a = math.radians(elev), math.radians(azim)
    eye = dist * np.array([math.cos(e) * math.sin(a), math.sin(e), math.cos(e) * math.cos(a)])
    z = -eye / np.linalg.norm(eye)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    R = np.stack((x, np.cross(z, x), z), 1)
    return torch.from_numpy(R), torch.from_numpy(-R.T @ eye)


def screen(points: Tensor, R: Tensor, T: Tensor, size: tuple[int, int], focal: float, parallel: bool = False) -> Tensor:
    """`transform_points_screen`: (x, y) in pixels, y down, and the depth. The shorter side of NDC is [−1, 1]."""
    points = points.double() @ R + T
    depth = points[..., 2:]
    ndc = focal * points[..., :2] / (1 if parallel else depth)
    middle = torch.tensor([size[1] / 2, size[0] / 2]).double()
    return torch.cat((middle - ndc * min(size) / 2, depth), -1)


def rasterize(corners: Tensor, size: tuple[int, int], parallel: bool = False) -> tuple[Tensor, Tensor, Tensor]:
    """`MeshRasterizer` of corners on the screen [F, 3, 3]: pix_to_face, zbuf and bary_coords of one face a pixel."""
    face = torch.full(size, -1)
    zbuf, bary = torch.full(size, torch.inf).double(), torch.zeros(*size, 3).double()
    y, x = torch.meshgrid(*(torch.arange(n).double() + 0.5 for n in size), indexing="ij")
    pixels = torch.stack((x, y, torch.ones_like(x)), -1)
    for number, (place, depth) in enumerate(zip(corners[..., :2], corners[..., 2], strict=True)):
        (left, top), (right, bottom) = place.amin(0).long().tolist(), (place.amax(0).long() + 1).tolist()
        box = slice(max(top, 0), max(bottom, 0)), slice(max(left, 0), max(right, 0))
        flat = pixels[box] @ torch.linalg.inv(torch.cat((place, torch.ones(3, 1).double()), 1))
        share = flat if parallel else flat / depth
        weights = share / share.sum(-1, keepdim=True)
        z = weights @ depth
        nearer = (flat >= 0).all(-1) & (z < zbuf[box])
        for image, values in ((zbuf, z), (bary, weights)):
            image[box][nearer] = values[nearer]
        face[box][nearer] = number
    return face, zbuf, bary


def shaded(points: Tensor, normals: Tensor, albedo: Tensor, eye: Tensor, light: dict[str, Any]) -> Tensor:
    """Phong's model with PyTorch3D's default colours: albedo · (0.5 + 0.3 max(n · l, 0)) + 0.2 max(v · r, 0)^64."""
    normals = normalize(normals, dim=-1)
    towards = light["direction"] if "direction" in light else light["location"] - points
    towards = normalize(towards.double().expand(points.shape), dim=-1)
    facing = (normals * towards).sum(-1, keepdim=True)
    mirrored = 2 * facing * normals - towards
    cosine = (normalize(eye - points, dim=-1) * mirrored).sum(-1, keepdim=True)
    return albedo * (0.5 + 0.3 * relu(facing)) + 0.2 * (relu(cosine) * (facing > 0)) ** 64


class Scene:
    """What PyTorch3D draws of the page's mesh from its camera, at twice the size, for averages of 2 × 2 pixels."""

    def __init__(self, given: dict[str, Any], mesh: tuple[Tensor, Tensor] | None = None) -> None:
        self.vertices, self.faces = (part.detach() for part in mesh or (given["vertices"], given["faces"]))
        self.vertices, self.faces = self.vertices.double(), self.faces.long()
        self.R, self.T = view(given["dist"], given["elev"], given["azim"])
        self.eye = -self.R @ self.T
        self.size = (2 * given["size"][0], 2 * given["size"][1])
        self.corners = screen(self.vertices, self.R, self.T, self.size, FOCAL)[self.faces]
        self.face, self.zbuf, self.bary = rasterize(self.corners, self.size)
        self.mask = self.face >= 0

    def interpolate(self, attributes: Tensor) -> Tensor:
        """`interpolate_face_attributes` of attributes [F, 3, C]."""
        return (self.bary[..., None] * attributes.double()[self.face]).sum(-2) * self.mask[..., None]

    def normals(self) -> Tensor:
        """`verts_normals_packed`: sums of cross products, whose lengths are areas."""
        a, b, c = self.vertices[self.faces].unbind(1)
        sums = torch.zeros_like(self.vertices)
        for corner in range(3):
            sums.index_add_(0, self.faces[:, corner], torch.linalg.cross(b - a, c - a))
        return normalize(sums, dim=-1)

    def phong(self, light: dict[str, Any], albedo: Tensor | None = None) -> Tensor:
        points, normals = (self.interpolate(part[self.faces]) for part in (self.vertices, self.normals()))
        albedo = torch.ones_like(points) if albedo is None else self.interpolate(albedo[self.faces])
        return shaded(points, normals, albedo, self.eye, light)

    def picture(self, colors: Tensor, background: float = 0.0) -> Tensor:
        """Colours over a background, averaged to [C, H, W]."""
        return avg_pool2d(torch.where(self.mask[..., None], colors, background).movedim(-1, 0), 2)


LOCATION = torch.tensor([0.0, 1.0, 2.0])


@pytest.fixture
def given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    monkeypatch.chdir(tmp_path)
    names = PAGE.names()
    for left in (
        "look_at_view_transform",
        "FoVPerspectiveCameras(R=R, T=T, fov=60)`",
        "cameras.transform_points_screen",
    ):
        (row,) = [row for start, row in PAGE.rows.items() if start.lstrip("`").startswith(left) and "own" not in start]
        exec(row.split("`")[1], names)
    return names


@pytest.fixture
def drawn(given: dict[str, Any]) -> dict[str, Any]:
    given["fragments"] = nr.fragments(given["mesh"], given["camera"], given["size"])
    return given


def test_every_row_has_a_check() -> None:
    assert not PAGE.missing()


@pytest.mark.parametrize("left", PAGE.rows)
def test_row(left: str, drawn: dict[str, Any]) -> None:
    PAGE.check(left, drawn)


# Meshes


@PAGE.row("`load_objs_as_meshes")
def _(given, values):
    lines = [line.split() for line in Path("a.obj").read_text().splitlines()]
    vertices = torch.tensor([[float(n) for n in line[1:4]] for line in lines if line and line[0] == "v"])
    faces = torch.tensor([[int(n.split("/")[0]) - 1 for n in line[1:]] for line in lines if line and line[0] == "f"])
    for mesh in values:
        assert torch.equal(mesh.vertices.detach(), vertices) and torch.equal(mesh.faces.long(), faces)


@PAGE.row("`Meshes(verts=[v1, v2]")
def _(given, values):
    meshes, (vertices, faces, _) = values[0], values[-1]
    alpha = nr.render(meshes, given["camera"], given["size"], outputs="alpha").alpha
    for n, mesh in enumerate(meshes):
        scene = Scene(given, (mesh.vertices, mesh.faces))
        same_but_at_edges(alpha[n], scene.picture(torch.ones(*scene.size, 1))[0], 1e-6, AT_EDGES)
        # `verts_padded` and `faces_padded` of PyTorch3D: zeros, and −1.
        count, number = len(mesh.vertices), len(mesh.faces)
        assert torch.equal(vertices[n, :count], mesh.vertices) and not vertices[n, count:].any()
        assert torch.equal(faces[n, :number], mesh.faces) and (faces[n, number:] == -1).all()


@PAGE.row("`Meshes(verts, faces)`, one")
def _(given, values):
    alpha = nr.render(values[0], given["camera"], given["size"], outputs="alpha").alpha
    scene = Scene(given)
    expected = scene.picture(torch.ones(*scene.size, 1)).expand(2, -1, -1)
    same_but_at_edges(alpha, expected, 1e-6, AT_EDGES)


@PAGE.row("`meshes.extend(N)`")
def _(given, values):
    eyes = nr.get_points_from_angles(given["dist"], given["elev"], 180 - torch.arange(given["N"]) * 45.0)
    alpha = nr.render(values[0], nr.Camera.look_at(eyes, viewing_angle=30), given["size"], outputs="alpha").alpha
    for n in range(1, given["N"], 2):
        scene = Scene({**given, "azim": 45.0 * n})
        same_but_at_edges(alpha[n], scene.picture(torch.ones(*scene.size, 1))[0], 1e-6, AT_EDGES)


@PAGE.row("`meshes.offset_verts(", "`meshes.scale_verts(")
def _(given, values):
    offsets, factor = given["offsets"].requires_grad_(), torch.tensor(0.5, requires_grad=True)
    mesh = given["mesh"]
    for moved, cause, expected in (
        (mesh.replace(vertices=mesh.vertices + offsets), offsets, mesh.vertices + offsets),
        (mesh.replace(vertices=mesh.vertices * factor), factor, mesh.vertices * factor),
    ):
        assert torch.equal(moved.vertices, expected)
        nr.losses.laplacian(moved.vertices, moved.faces).backward()
        assert cause.grad.abs().max() > 0
    move = [given["offsets"].detach(), 0.0] if len(values) > 1 else [0.0, 0.0]
    expected = mesh.vertices + move[0] if len(values) > 1 else mesh.vertices * 0.5
    torch.testing.assert_close(values[0].vertices.detach(), expected.detach())


@PAGE.row("`join_meshes_as_scene")
def _(given, values):
    vertices, faces, _ = values[0]
    first, second = given["mesh"], given["other"]
    assert torch.equal(vertices, torch.cat((first.vertices, second.vertices)))
    assert torch.equal(faces, torch.cat((first.faces, second.faces + len(first.vertices))))


def ico_sphere(level: int) -> tuple[Tensor, Tensor]:
    """PyTorch3D's sphere: an icosahedron, the cyclic permutations of (±1, ±φ, 0), split at midpoints on the sphere."""
    long, signs = (1 + 5**0.5) / 2, ((1, 1), (1, -1), (-1, 1), (-1, -1))
    corners = torch.tensor([[a, b * long, 0.0] for a, b in signs]).double()
    corners = normalize(torch.cat([corners.roll(n, 1) for n in range(3)]), dim=1)
    near = torch.cdist(corners, corners) < 1.1
    faces = [
        [i, j, k] for i in range(12) for j in range(i) for k in range(j) if near[i, j] and near[j, k] and near[i, k]
    ]
    triangles = corners[torch.tensor(faces)]
    inwards = torch.linalg.det(triangles) < 0
    triangles[inwards] = triangles[inwards].flip(1)
    for _ in range(level):
        a, b, c = triangles.unbind(1)
        ab, bc, ca = (normalize(sum, dim=1) for sum in (a + b, b + c, c + a))
        triangles = torch.stack((a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca), 1).reshape(-1, 3, 3)
    _, index, first = np.unique(
        triangles.reshape(-1, 3).numpy().round(6), axis=0, return_inverse=True, return_index=True
    )
    return triangles.reshape(-1, 3)[index].float(), torch.from_numpy(first.reshape(-1, 3))


@PAGE.row("`ico_sphere(3)`")
def _(given, values):
    expected = ico_sphere(3)
    for vertices, faces in (values[0], (values[1].vertices, values[1].faces)):
        assert len(vertices) == len(expected[0]) == 642 and len(faces) == len(expected[1]) == 1280
        torch.testing.assert_close(vertices.norm(dim=1), torch.ones(642))
        assert len(edges_of(faces.long())) == len(edges_of(expected[1])) == 1920


@PAGE.row("`TexturesVertex(colors)`")
def _(given, values):
    colors = given["colors"].clone().requires_grad_()
    mesh = nr.Mesh(given["vertices"], given["faces"], vertex_colors=colors)
    images = nr.render(mesh, given["camera"], given["size"], light=None)
    scene = Scene(given)
    expected = scene.picture(scene.interpolate(given["colors"][given["faces"].long()]))
    same_but_at_edges(images.rgb[0], expected, 1e-4, AT_EDGES)
    images.rgb.sum().backward()
    assert colors.grad.abs().max() > 0
    torch.testing.assert_close(values[0].vertex_colors, given["colors"])


@PAGE.row("`TexturesUV(")
def _(given, values):
    # Bilinear between the centres of texels; with v up, row 0 of the image is at v = 1 (align_corners=False).
    image = torch.linspace(0, 1, 32)[:, None, None].expand(32, 32, 3)
    mesh = nr.UVMesh(given["vertices"], given["faces"], (0.25 + given["verts_uvs"] / 2, given["faces_uvs"]), image)
    scene = Scene(given)
    v = scene.interpolate((0.25 + given["verts_uvs"] / 2)[given["faces_uvs"].long()])[..., 1:]
    expected = scene.picture((((1 - v) * 32 - 0.5) / 31).expand(-1, -1, 3))
    found = nr.render(mesh, given["camera"], given["size"], light=None).rgb[0]
    # A ramp is equal in all mipmaps inside, but for their borders.
    same_but_at_edges(found, expected, 0.02, 2 * AT_EDGES)


@PAGE.row("`TexturesAtlas`")
def _(given, values):
    # With R = 1, as with T = 1, a face has one colour.
    colors = torch.rand(len(given["faces"]), 3)
    mesh = nr.Mesh(given["vertices"], given["faces"], colors[:, None, None, None])
    scene = Scene(given)
    found = nr.render(mesh, given["camera"], given["size"], light=None).rgb[0]
    same_but_at_edges(found, scene.picture(colors.double()[scene.face]), 1e-5, AT_EDGES)
    assert values[0].shape[:1] == (len(given["faces"]),)


@PAGE.row("`SubdivideMeshes()")
def _(given, values):
    # Each face becomes four, with the midpoints of edges.
    corners = given["vertices"].double()[given["faces"].long()]
    middle = (corners + corners.roll(-1, 1)) / 2
    centres = values[0].vertices.double()[values[0].faces.long()].mean(1)
    expected = [torch.stack((corners[:, k], middle[:, k], middle[:, k - 1]), 1).mean(1) for k in range(3)]
    distances = torch.cdist(torch.cat((*expected, middle.mean(1))), centres)
    assert (distances.amin(0) < 1e-6).all() and (distances.amin(1) < 1e-6).all()
    assert len(values[1].faces) == 16 * len(given["faces"])


@PAGE.row("`sample_points_from_meshes(")
def _(given, values):
    points, normals = nr.sample_points(given["other"], 4000).points, nr.sample_points(given["other"], 100).normals
    assert values[0].shape[-2:] == values[1].shape[-2:] == (100, 3)
    # Uniform on a cube's surface: on its sides, and as many on each as chance allows (six standard deviations).
    largest = given["other"].vertices.abs().max()
    torch.testing.assert_close(points.abs().amax(-1), largest.expand(points.shape[:-1]))
    sides = torch.stack((points, -points), -1).flatten(-2).argmax(-1).flatten().bincount(minlength=6)
    assert ((sides - 4000 / 6).abs() < 6 * (4000 * 5 / 36) ** 0.5).all()
    torch.testing.assert_close(normals.abs().amax(-1), torch.ones(normals.shape[:-1]))


@PAGE.row("`meshes.submeshes(")
def _(given, values):
    corners = values[0].vertices[values[0].faces.long()]
    assert torch.equal(corners, given["vertices"][given["faces"][:10].long()])


@PAGE.row("`IO().save_mesh(")
def _(given, values):
    assert torch.equal(nr.Mesh.load("a.ply").vertices, given["vertices"])


def edges_of(faces: Tensor) -> Tensor:
    return torch.unique(torch.cat((faces[:, :2], faces[:, 1:], faces[:, [2, 0]])).sort(1).values, dim=0)


@PAGE.row("`mesh_laplacian_smoothing(")
def _(given, values):
    vertices, edges = given["vertices"].double(), edges_of(given["faces"].long())
    neighbours = torch.zeros(len(vertices), len(vertices), dtype=torch.float64)
    neighbours[edges[:, 0], edges[:, 1]] = neighbours[edges[:, 1], edges[:, 0]] = 1
    offset = neighbours / neighbours.sum(1, keepdim=True) @ vertices - vertices
    found = nr.losses.laplacian(vertices, given["faces"], squared=False)
    torch.testing.assert_close(found, offset.norm(dim=1).mean(), rtol=1e-12, atol=0)
    torch.testing.assert_close(values[0].double(), offset.norm(dim=1).mean(), **rounding(64))
    torch.testing.assert_close(nr.losses.laplacian(vertices, given["faces"]), offset.square().sum(1).mean())
    # Several meshes: the mean of their means.
    padded = nr.batch([given["mesh"], given["other"]])
    each = [nr.losses.laplacian(m.vertices, m.faces, squared=False) for m in (given["mesh"], given["other"])]
    torch.testing.assert_close(nr.losses.laplacian(*padded[:2], squared=False), torch.stack(each).mean())


@PAGE.row("`mesh_edge_loss(")
def _(given, values):
    vertices, edges = given["vertices"].double(), edges_of(given["faces"].long())
    lengths = (vertices[edges[:, 0]] - vertices[edges[:, 1]]).norm(dim=1)
    torch.testing.assert_close(values[0].double(), lengths.square().mean(), **rounding(64))


@PAGE.row("`mesh_normal_consistency(")
def _(given, values):
    vertices, faces = given["vertices"].double(), given["faces"].long()
    a, b, c = vertices[faces].unbind(1)
    normals = torch.linalg.cross(b - a, c - a)
    owners: dict[tuple[int, ...], list[int]] = {}
    for number, face in enumerate(faces.tolist()):
        for k in range(3):
            owners.setdefault(tuple(sorted((face[k], face[k - 1]))), []).append(number)
    pairs = torch.tensor([both for both in owners.values() if len(both) == 2])
    expected = (1 - torch.cosine_similarity(normals[pairs[:, 0]], normals[pairs[:, 1]], dim=1)).mean()
    torch.testing.assert_close(values[0].double(), expected, **rounding(64))


# Cameras


@PAGE.row("`look_at_view_transform(")
def _(given, values):
    R, T = view(given["dist"], given["elev"], given["azim"])
    torch.testing.assert_close(torch.tensor(given["eye"]).double(), -R @ T, **rounding(16, 3))


@PAGE.row("`FoVPerspectiveCameras(R=R, T=T, fov=60)`", "`cameras.transform_points_screen(")
def _(given, values):
    R, T = view(given["dist"], given["elev"], given["azim"])
    expected = screen(given["points"], R, T, given["size"], FOCAL)
    torch.testing.assert_close(given["pixels"][0].double(), expected[:, :2], **rounding(64, 64))
    torch.testing.assert_close(given["depth"][0].double(), expected[:, 2], **rounding(16, 4))


@PAGE.row("`FoVOrthographicCameras(")
def _(given, values):
    R, T = view(given["dist"], given["elev"], given["azim"])
    expected = screen(given["points"], R, T, given["size"], 1.0, parallel=True)
    found, depth = values[0].project(given["points"], given["size"])
    torch.testing.assert_close(found[0].double(), expected[:, :2], **rounding(64, 64))
    torch.testing.assert_close(depth[0].double(), expected[:, 2], **rounding(16, 4))
    sphere = nr.Mesh(*ico_sphere(5), texture_size=1)
    camera = nr.Camera.look_at(nr.get_points_from_angles(2.7, 45.0, 135.0), orthographic=True, scale=1.0)
    lights = [nr.Light(0.5, 0.0), nr.PointLight((0.0, 0.0, 2.0), 0.3, falloff=0)]
    rgb = nr.render(sphere, camera, 512, light=lights, shading=given["phong"], anti_aliasing=False).rgb
    assert mean_difference(rgb, golden("simple_sphere_light_phong_elevated_FoVOrthographicCameras")) < 0.003


@PAGE.row("`PerspectiveCameras(", "`cameras_from_opencv_projection(")
def _(given, values):
    points = given["points"].double() @ given["R"].double().T + torch.tensor(given["tvec"]).double()
    pixels = points @ given["K"].double().T
    found, depth = values[0].project(given["points"], given["size"])
    torch.testing.assert_close(found[0].double(), pixels[:, :2] / pixels[:, 2:], **rounding(64, 64))
    torch.testing.assert_close(depth[0].double(), points[:, 2], **rounding(16, 4))


@PAGE.row("`FishEyeCameras(")
def _(given, values):
    # OpenCV's model: the angle θ to the axis becomes θ (1 + k1 θ²); the page says that PyTorch3D's is another.
    points = given["points"].double() + torch.tensor(given["tvec"]).double()
    across = points[:, :2].norm(dim=1)
    angle = torch.atan2(across, points[:, 2])
    bent = points[:, :2] * (angle * (1 + 0.1 * angle**2) / across)[:, None]
    K = given["K"].double()
    found, _ = values[0].project(given["points"], given["size"])
    torch.testing.assert_close(found[0].double(), bent @ K[:2, :2].T + K[:2, 2], **rounding(128, 64))


@PAGE.row("`FoVPerspectiveCameras(R=R, T=T, fov=60)` with")
def _(given, values):
    R, T = view(given["dist"], given["elev"], given["azim"])
    matrix = torch.eye(4, dtype=torch.float64)
    matrix[:3, :3], matrix[3, :3] = R, T
    for camera, own, shift in (
        (nr.Camera.from_matrix(world_to_camera=matrix, convention="pytorch3d", viewing_angle=30), R, T),
        (values[0], given["view"][:3, :3].double(), given["view"][3, :3].double()),
    ):
        expected = screen(given["points"], own, shift, given["size"], FOCAL)
        found = camera.project(given["points"], given["size"])[0][0]
        torch.testing.assert_close(found.double(), expected[:, :2], **rounding(64, 64))


@PAGE.row("`cameras.unproject_points(")
def _(given, values):
    torch.testing.assert_close(values[0][0], given["points"], **rounding(256, 4))


@PAGE.row("`cameras[i]`")
def _(given, values):
    assert len(values[0]) == 1 and len(values[1]) == 2
    both = values[1].project(given["points"], given["size"])[0]
    assert torch.equal(both[0], both[1]) and torch.equal(both[:1], given["pixels"])


# Pictures


def mean_difference(rgb: Tensor, expected: Tensor) -> float:
    """Return the mean absolute difference of an image [1, 3, H, W] from a golden picture [H, W, 3]."""
    return float((rgb[0].movedim(0, -1).clamp(0, 1) - expected).abs().mean())


@PAGE.row("`PointLights(", "`MeshRenderer(rasterizer, SoftPhongShader(")
def _(given, values):
    lights = given["lights"] if isinstance(values[0], nr.Images) else values[0]
    rgb = nr.render(given["mesh"], given["camera"], given["size"], light=lights, shading=given["phong"]).rgb[0]
    scene = Scene(given)
    same_but_at_edges(rgb, scene.picture(scene.phong({"location": LOCATION})), 1e-4, AT_EDGES)


@PAGE.row("`DirectionalLights(")
def _(given, values):
    direction = torch.tensor([0.0, 1.0, 0.0])
    rgb = nr.render(given["mesh"], given["camera"], given["size"], light=values[0], shading=given["phong"]).rgb[0]
    scene = Scene(given)
    same_but_at_edges(rgb, scene.picture(scene.phong({"direction": direction})), 1e-4, AT_EDGES)


@PAGE.row("`AmbientLights()`")
def _(given, values):
    scene = Scene(given)
    white = scene.picture(torch.ones(*scene.size, 3).double())
    same_but_at_edges(values[0].rgb[0], white, 1e-6, AT_EDGES)
    lit = nr.render(given["mesh"], given["camera"], given["size"], light=values[1]).rgb
    torch.testing.assert_close(lit, values[0].rgb)


def golden_sphere() -> dict[str, Any]:
    """Names of the page for the sphere of the golden pictures."""
    vertices, faces = ico_sphere(5)
    names = PAGE.names() | {"vertices": vertices, "faces": faces, "mesh": nr.Mesh(vertices, faces, texture_size=1)}
    eye = nr.get_points_from_angles(2.7, 45.0, 135.0)
    lights = [nr.Light(0.5, 0.0), nr.PointLight((0.0, 0.0, 2.0), 0.3, falloff=0)]
    camera = nr.Camera.look_at(eye, viewing_angle=30)
    return names | {"eye": eye, "camera": camera, "lights": lights, "size": 512, "colors": torch.ones(len(vertices), 3)}


@PAGE.row("`MeshRenderer(rasterizer, HardPhongShader(")
def _(given, values):
    code = PAGE.rows["`MeshRenderer(rasterizer, HardPhongShader(lights=lights))`"].split("`")[1]
    rgb = eval(code, golden_sphere()).rgb
    expected = golden("simple_sphere_light_phong_elevated_FoVPerspectiveCameras")
    # The picture's colours are cut to bytes, and a dozen pixels at the outline show the background in one of the two.
    assert mean_difference(rgb, expected) < STEP
    same_but_at_edges(rgb[0].movedim(0, -1), expected, 2 * STEP, 1e-4)
    assert values[0].rgb.shape == (1, 3, *given["size"])


@PAGE.row("`SoftGouraudShader`")
def _(given, values):
    names = golden_sphere()
    for program in PAGE.programs[3:5]:
        exec(program.replace("(mesh, camera, size)", "(mesh, camera, size, anti_aliasing=False)"), names)
    expected = golden("simple_sphere_light_gouraud_elevated_FoVPerspectiveCameras")
    assert mean_difference(names["gouraud"], expected) < STEP
    same_but_at_edges(names["gouraud"][0].movedim(0, -1), expected, 4 * STEP, 1e-4)
    # The row: light on pixels differs little on a fine mesh.
    lit = nr.render(names["mesh"], names["camera"], 512, light=names["lights"], shading=names["phong"])
    assert mean_difference(lit.rgb, expected) < 0.01


@PAGE.row("`HardFlatShader(")
def _(given, values):
    names = golden_sphere()
    for program in PAGE.programs[3:5]:
        exec(program.replace("(mesh, camera, size)", "(mesh, camera, size, anti_aliasing=False)"), names)
    expected = golden("simple_sphere_light_flat_elevated_FoVPerspectiveCameras")
    assert mean_difference(names["flat"], expected) < STEP
    same_but_at_edges(names["flat"][0].movedim(0, -1), expected, 2 * STEP, 0.01)
    # The row has no highlights.
    scene = Scene(given)
    a, b, c = scene.vertices[scene.faces].unbind(1)
    towards, normals = (
        normalize(LOCATION - (a + b + c) / 3, dim=-1),
        normalize(torch.linalg.cross(b - a, c - a), dim=-1),
    )
    lit = 0.5 + 0.3 * relu((normals * towards).sum(-1, keepdim=True)).expand(-1, 3)
    same_but_at_edges(values[0].rgb[0], scene.picture(lit[scene.face]), 1e-4, AT_EDGES)


@PAGE.row("`MeshRenderer(rasterizer, SoftSilhouetteShader())`")
def _(given, values):
    scene = Scene(given)
    same_but_at_edges(values[0].alpha[0], scene.picture(torch.ones(*scene.size, 1))[0], 1e-6, AT_EDGES)
    vertices, faces = nr.icosphere(5)
    camera = nr.Camera.look_at(nr.get_points_from_angles(2.7, 0.0, 180.0), viewing_angle=30)
    corners = nr.vertices_to_faces(camera(vertices), faces)
    quarter = (corners[0, :, :, :2] > -0.1).all((1, 2))  # the upper right one, for speed
    soft = nr.soft_silhouettes(corners[:, quarter], 512, sigma=1e-4)[0, :256, 256:]
    expected = golden("FoVPerspectiveCameras_silhouette")[:256, 256:]
    # PyTorch3D blends the 80 nearest faces of a pixel, and cuts its picture to bytes.
    assert (soft - expected).abs().mean() < STEP
    assert values[1].shape == (1, 64, 64)


@PAGE.row("`BlendParams(")
def _(given, values):
    scene = Scene(given)
    white = scene.picture(torch.ones(*scene.size, 3).double(), 1.0)
    same_but_at_edges(values[0].rgb[0], white, 1e-6, 0.0)  # white before white
    blue = nr.render(given["mesh"], given["camera"], given["size"], light=None, background=(0.0, 0.0, 1.0)).rgb[0]
    empty = ~scene.picture(torch.ones(*scene.size, 1))[0].bool()
    same_but_at_edges(blue[:, empty], torch.tensor([0.0, 0.0, 1.0])[:, None].expand(3, int(empty.sum())), 0.0, 0.0)


@PAGE.row("`MeshRasterizer(…)", "`fragments.pix_to_face`", "`fragments.zbuf`")
def _(given, values):
    scene, fragments = Scene(given), given["fragments"]
    same_but_at_edges(fragments.face_index[0], scene.face, 0.0, AT_EDGES)
    same = (fragments.face_index[0] == scene.face) & scene.mask
    torch.testing.assert_close(fragments.depth[0][same].double(), scene.zbuf[same], **rounding(256, 4))
    # Weights change by 1 over a face of some pixels, whose corners are a few roundings of 100 pixels off.
    torch.testing.assert_close(fragments.weights[0][same].double(), scene.bary[same], rtol=0, atol=1e-3)
    assert values


@PAGE.row("`rasterize_meshes(")
def _(given, values):
    """x to the left, parallel rays: bary_coords are not corrected for perspective."""
    height, width = given["size"]
    corners = given["screen"][given["faces"].long()].double()
    pixels = torch.tensor([width, height]) / 2 - corners[..., :2] * min(height, width) / 2
    face, depth, weights = rasterize(torch.cat((pixels, corners[..., 2:]), -1), (height, width), parallel=True)
    found = given["on_screen"]
    same_but_at_edges(found.face_index[0].long(), face, 0.0, AT_EDGES)
    seen = (found.face_index[0] == face) & (face >= 0)
    assert seen.sum() > 500
    torch.testing.assert_close(found.depth[0][seen].double(), depth[seen], rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(found.weights[0][seen].double(), weights[seen], rtol=0, atol=1e-3)


@PAGE.row("`faces_per_pixel=4`")
def _(given, values):
    # The second layer of a convex mesh is its back: what is nearest without the faces in front.
    scene = Scene(given)
    front = torch.zeros(len(scene.faces), dtype=torch.bool)
    front[scene.face[scene.mask]] = True
    a, b, c = scene.vertices[scene.faces].unbind(1)
    behind = ((torch.linalg.cross(b - a, c - a) * (scene.eye - a)).sum(1) < 0).nonzero()[:, 0]
    face, _, _ = rasterize(scene.corners[behind], scene.size)
    expected = torch.where(face >= 0, behind[face], -1)
    assert len(values[0]) == 4
    same_but_at_edges(values[0][0].face_index[0], scene.face, 0.0, AT_EDGES)
    same_but_at_edges(values[0][1].face_index[0], expected, 0.0, AT_EDGES)
    assert (values[0][2].face_index[0] >= 0).double().mean() < AT_EDGES


@PAGE.row("the same, with an image")
def _(given, values):
    images, scene = values[0], Scene(given)
    corners = screen(scene.vertices, scene.R, scene.T, given["size"], FOCAL)[scene.faces]
    face, _, bary = rasterize(corners, given["size"])
    same_but_at_edges(images.face_index[0], face, 0.0, AT_EDGES)
    same = (images.face_index[0] == face) & (face >= 0)
    torch.testing.assert_close(images.barycentric[0][:, same].double(), bary[same].T, rtol=0, atol=1e-3)
    points = scene.picture(scene.interpolate(scene.vertices[scene.faces]))
    same_but_at_edges(images.position[0], points, 1e-4, AT_EDGES)
    a, b, c = scene.vertices[scene.faces].unbind(1)
    normals = normalize(torch.linalg.cross(b - a, c - a), dim=-1)
    same_but_at_edges(images.normal[0], scene.picture(normals[scene.face]), 1e-4, AT_EDGES)
    same_but_at_edges(images.rgb[0], scene.picture(torch.ones(*scene.size, 3).double()), 1e-6, AT_EDGES)


@PAGE.row("`images[..., 3]`")
def _(given, values):
    scene = Scene(given)
    expected = scene.picture(torch.ones(*scene.size, 1))
    same_but_at_edges(values[0], expected, 1e-6, AT_EDGES)
    same_but_at_edges(values[1], expected, 1e-6, AT_EDGES)


@PAGE.row("`interpolate_face_attributes(")
def _(given, values):
    scene = Scene(given)
    expected = scene.interpolate(scene.vertices[scene.faces])
    for found in values:
        same_but_at_edges(found[0], expected, 1e-4, AT_EDGES)


@PAGE.row("`pix_to_face.unique()`")
def _(given, values):
    scene, fragments = Scene(given), given["fragments"]
    seen = torch.zeros(len(scene.faces), dtype=torch.bool)
    seen[fragments.face_index[fragments.face_index >= 0].long().unique()] = True
    assert torch.equal(values[0][0], seen)
    same_but_at_edges(seen.float(), torch.isin(torch.arange(len(seen)), scene.face).float(), 0.0, 2 / len(seen))
    corners = torch.isin(torch.arange(len(scene.vertices)), scene.faces[seen])
    assert torch.equal(values[1][0], corners)


# Programs


@pytest.mark.parametrize(("name", "azim", "z"), [("back", 0.0, 2.0), ("front", 180.0, -2.0)])
def test_the_program_draws_the_golden_cow(name: str, azim: float, z: float) -> None:
    program = PAGE.programs[2].replace("examples/data/spot.obj", str(EXAMPLES / "data" / "spot.obj"))  # the same mesh
    program = program.replace("2.7, 0.0, 0.0", f"2.7, 0.0, {180 - azim}").replace("-2.0), 0.3", f"{z}), 0.3")
    names: dict[str, Any] = {"nr": nr}
    exec(program, names)
    expected = golden(f"texture_map_{name}_MeshRasterizer")
    assert mean_difference(names["images"].rgb, expected) < 0.002  # the page says 0.0011 and 0.0012
    # The largest differences are at outlines: inside, where alpha is 1 in a neighbourhood, they are small.
    inside = -torch.nn.functional.max_pool2d(-names["images"].alpha[None], 5, 1, 2)[0, 0] == 1
    difference = (names["images"].rgb[0].movedim(0, -1) - expected).abs().amax(-1)
    assert difference[inside].quantile(0.99) < 0.08


def test_colours_of_vertices_are_lit_and_get_gradients(given: dict[str, Any]) -> None:
    given["colors"].requires_grad_()
    given["mesh"] = given["mesh"].trainable("vertices")
    exec(PAGE.programs[3], given)
    scene, white = Scene(given), 1.0
    expected = scene.picture(scene.phong({"location": LOCATION}, given["colors"].detach()), white)
    same_but_at_edges(given["picture"][0].detach(), expected, 1e-4, AT_EDGES)
    given["picture"].square().sum().backward()
    assert given["colors"].grad.abs().max() > 0 and given["mesh"].vertices.grad.abs().max() > 0
