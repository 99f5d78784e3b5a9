"""Losses and metrics against formulas written face by face and edge by edge."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch
from torch.autograd import gradcheck

import neural_renderer as nr
from neural_renderer.base import validate
from neural_renderer.meshes.topology import Topology
from neural_renderer.optim import losses, metrics

TETRAHEDRON = torch.tensor([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
# Two faces of a square, one in its plane beside it, and a vertex (6) that no face uses.
STRIP = torch.tensor([[0, 1, 2], [2, 1, 3], [1, 4, 3]], dtype=torch.int32)
FLAT = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [2, 0, 0], [5, 5, 5], [6, 6, 6]]).double()


def vertices(*shape: int) -> torch.Tensor:
    return torch.randn(*shape, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def test_topology():
    topology = Topology.of(TETRAHEDRON)
    assert topology.edges.tolist() == [list(e) for e in itertools.combinations(range(4), 2)]
    assert topology.vertices == 4 and len(topology.hinges) == 6
    assert all(sorted(h) == [0, 1, 2, 3] for h in topology.hinges.tolist())
    strip = Topology.of(STRIP)
    assert {(*h[:2], *sorted(h[2:])) for h in strip.hinges.tolist()} == {(1, 2, 0, 3), (1, 3, 2, 4)}
    assert len(strip.edges) == 7
    book = Topology.of(torch.tensor([[0, 1, 2], [0, 1, 3], [1, 0, 4], [2, 2, 3]]))  # three pages and a broken face
    assert len(book.hinges) == 2 and [2, 3] not in book.edges.tolist()
    assert Topology.of(TETRAHEDRON[:0]).edges.shape == (0, 2)
    with pytest.raises(ValueError, match="faces: expected indices"):
        Topology.of(TETRAHEDRON - 1)


def test_silhouette_iou():
    s = torch.zeros(2, 4, 4, dtype=torch.float64)
    t = s.clone()
    s[0, :2], t[0, 1:3] = 1.0, 1.0  # IoU 4 / 12
    s[1], t[1] = 0.5, 1.0  # IoU 1/2
    torch.testing.assert_close(losses.silhouette_iou_loss(s, t).item(), 1 - (1 / 3 + 1 / 2) / 2)
    assert losses.silhouette_iou_loss(t, t) == 0 and losses.silhouette_iou_loss(t, t.bool()) == 0
    empty = torch.zeros(1, 4, 4, requires_grad=True)
    losses.silhouette_iou_loss(empty, torch.zeros(1, 4, 4)).backward()
    assert losses.silhouette_iou_loss(empty, torch.zeros(1, 4, 4)) == 0 and torch.equal(
        empty.grad, torch.zeros(1, 4, 4)
    )
    assert losses.silhouette_iou_loss(empty, torch.ones(1, 4, 4)) == 1
    assert metrics.silhouette_iou(s, t).tolist() == pytest.approx([1 / 3, 1 / 2])
    assert metrics.silhouette_iou(s, t, threshold=0.5).tolist() == pytest.approx([1 / 3, 0])  # 0.5 is not above it
    assert metrics.silhouette_iou(s * 0, s > 9).tolist() == [1, 1]
    assert gradcheck(losses.silhouette_iou_loss, (torch.rand(2, 3, 3).double().requires_grad_(), torch.rand(2, 3, 3)))


def test_equal_anti_aliased_silhouettes_have_iou_1(tmp_path):
    camera = nr.Camera.look_at((0.4, 0.7, -2.7))
    for size in (32, 64, 128):
        alpha = nr.render(nr.Mesh.icosphere(2), camera, size, outputs="alpha").alpha
        partial = int(((alpha > 0) & (alpha < 1)).sum())
        assert (
            partial > 0 and losses.silhouette_iou_loss(alpha, alpha) == 0 and metrics.silhouette_iou(alpha, alpha) == 1
        )
        assert losses.soft_iou_loss(alpha, alpha) > 0.01  # the paper's formula keeps a remainder
        nr.save_image(tmp_path / "a.png", alpha[0])
        loaded = nr.load_image(tmp_path / "a.png")[None, ..., 0]
        # Rounding to eight bits moves each of them by up to 1/510; the second term is for the float32 sums.
        bound = partial / 510 / float(alpha.sum()) + 1e-6
        assert 0 <= 1 - metrics.silhouette_iou(alpha, loaded).item() <= bound
        # In the loss, a pixel's part is at most about (1/510)² / (1/2), at a coverage of 1/2; others round less.
        assert losses.silhouette_iou_loss(alpha, loaded).item() <= bound / 200 + 1e-6
    assert metrics.silhouette_iou(alpha * torch.nan, alpha).isnan()


def test_iou_losses_agree_on_binary_targets_with_gradients():
    target = (torch.rand(2, 6, 6) > 0.5).double()
    values = torch.rand(2, 6, 6).double()
    values[:, :3] = target[:, :3]  # ties
    found = []
    for loss in (losses.silhouette_iou_loss, losses.soft_iou_loss):
        predicted = values.clone().requires_grad_()
        value = loss(predicted, target)
        found.append((value.detach(), *torch.autograd.grad(value, predicted)))
    for pair in zip(*found, strict=True):
        torch.testing.assert_close(*pair)
    half = torch.full((1, 4, 4), 0.5, requires_grad=True)
    losses.silhouette_iou_loss(half, half.detach()).backward()
    assert torch.equal(half.grad, torch.zeros(1, 4, 4))  # a minimum within (0, 1)


def test_photometric():
    a, b = torch.rand(2, 2, 3, 4, 5, dtype=torch.float64)
    torch.testing.assert_close(losses.photometric(a, b), ((a - b) ** 2).mean())
    mask = torch.zeros(2, 4, 5)
    assert losses.photometric(a, b, mask) == 0
    mask[0, 1, 2] = 0.5
    torch.testing.assert_close(losses.photometric(a, b, mask), ((a - b)[0, :, 1, 2] ** 2).mean())


def test_total_variation():
    image = torch.tensor([[[[0.0, 1.0, 3.0], [2.0, 2.0, 2.0]]]])
    assert losses.total_variation(image) == (1 + 4 + 0 + 0) + (4 + 1 + 1)
    mask = torch.tensor([[[False, True, True], [True, False, False]]])
    assert losses.total_variation(image, mask) == 4 + 0 + 1 + 1


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_is_summed_in_float32(dtype):
    image, target = torch.rand(2, 2, 1, 400, 400, generator=torch.Generator().manual_seed(0)).to(dtype)
    image.requires_grad_()
    mask = torch.ones(2, 400, 400)
    for loss in (
        lambda a, b: losses.silhouette_iou_loss(a[:, 0], b[:, 0]),
        lambda a, b: losses.photometric(a, b, mask),
        lambda a, b: losses.total_variation(a - b),
    ):
        # The differences of neighbours, or of images, are rounded to 8 bits at least before they are summed.
        torch.testing.assert_close(loss(image, target), loss(image.float(), target.float()), rtol=2**-8, atol=0)
        (found,) = torch.autograd.grad(loss(image, target), image)
        assert found.dtype == dtype and found.isfinite().all() and found.any()
    v = (vertices(2, 4) * 100).to(dtype)
    for loss in (losses.laplacian, losses.edge_length, losses.normal_consistency, losses.smoothness):
        torch.testing.assert_close(loss(v, TETRAHEDRON), loss(v.float(), TETRAHEDRON))


def test_laplacian_and_edge_length():
    v = vertices(2, 4)
    neighbours_mean = (v.sum(1, keepdim=True) - v) / 3
    torch.testing.assert_close(losses.laplacian(v, TETRAHEDRON), ((neighbours_mean - v) ** 2).sum(-1).mean())
    pairs = [((v[:, i] - v[:, j]) ** 2).sum(-1) for i, j in itertools.combinations(range(4), 2)]
    torch.testing.assert_close(losses.edge_length(v, TETRAHEDRON), torch.stack(pairs).mean())
    lone = torch.zeros_like(FLAT)
    lone[6] = 9.0
    assert losses.laplacian(lone, STRIP) == 0


def cosine_at_edge(v0, v1, v2, v3):
    """The cosine of the angle between the perpendiculars from v2 and v3 onto the edge."""
    e = (v1 - v0) / np.linalg.norm(v1 - v0)
    p, q = ((v - v0) - ((v - v0) @ e) * e for v in (v2, v3))
    return p @ q / np.linalg.norm(p) / np.linalg.norm(q)


def test_bending():
    v = vertices(2, 4)
    cosines = np.array(
        [
            [cosine_at_edge(*m[[i, j]], *m[[k for k in range(4) if k not in (i, j)]])]
            for m in v.numpy()
            for i, j in itertools.combinations(range(4), 2)
        ]
    )
    np.testing.assert_allclose(losses.smoothness(v, TETRAHEDRON), ((cosines + 1) ** 2).sum() / 2)
    np.testing.assert_allclose(losses.normal_consistency(v, TETRAHEDRON), (cosines + 1).mean())
    assert losses.smoothness(FLAT, STRIP) == 0 and losses.normal_consistency(FLAT, STRIP) == 0
    assert losses.normal_consistency(FLAT, STRIP[:1]) == 0  # no two faces meet


@pytest.mark.parametrize("loss", [losses.laplacian, losses.edge_length, losses.normal_consistency, losses.smoothness])
def test_mesh_losses_have_right_gradients_and_take_a_topology(loss):
    v, topology = vertices(2, 4).requires_grad_(), Topology.of(TETRAHEDRON)
    assert gradcheck(lambda v: loss(v, topology), (v,))
    torch.testing.assert_close(loss(v, TETRAHEDRON), loss(v, topology))
    torch.testing.assert_close(loss(v[0], topology), loss(v[:1], topology))
    collapsed = torch.zeros(4, 3, requires_grad=True)
    value = loss(collapsed, topology)
    value.backward()
    assert value.isfinite() and collapsed.grad.isfinite().all()
    with pytest.raises(ValueError, match=r"faces: expected indices in \[0, 3\), got 3"):
        loss(v[:, :3], TETRAHEDRON)


@pytest.mark.parametrize("loss", [losses.laplacian, losses.edge_length, losses.normal_consistency, losses.smoothness])
def test_mesh_losses_check_their_vertices_once(loss, monkeypatch):
    v = vertices(2, 4)
    v[1, 2, 0] = float("nan")
    with pytest.raises(ValueError, match="vertices: expected finite numbers, got 1 "):
        loss(v, TETRAHEDRON)
    checked = []
    monkeypatch.setattr(validate, "finite", lambda name, value: checked.append(name) or 0.0)
    loss(v, TETRAHEDRON)
    assert checked == ["vertices"]
    value = torch.func.grad(loss)(vertices(2, 4), Topology.of(TETRAHEDRON))
    assert value.any()


@pytest.mark.parametrize(
    ("loss", "shape", "other"),
    [
        (losses.silhouette_iou_loss, (0, 4, 4), torch.ones(0, 4, 4)),
        (losses.photometric, (0, 3, 4, 4), torch.ones(0, 3, 4, 4)),
        (lambda image, mask: losses.photometric(image, image, mask), (0, 3, 4, 4), torch.ones(0, 4, 4)),
        (losses.total_variation, (0, 3, 4, 4), torch.ones(0, 4, 4)),
        (losses.laplacian, (0, 4, 3), TETRAHEDRON),
        (losses.edge_length, (0, 4, 3), TETRAHEDRON),
        (losses.normal_consistency, (0, 4, 3), TETRAHEDRON),
        (losses.smoothness, (0, 4, 3), TETRAHEDRON),
    ],
)
def test_an_empty_batch_costs_nothing(loss, shape, other):
    value = torch.zeros(shape, requires_grad=True)
    found = loss(value, other)
    found.backward()
    assert found == 0 and value.grad.shape == shape


def test_nan_in_an_image_is_nan_in_its_loss():
    image, target = torch.full((1, 4, 4), float("nan")), torch.ones(1, 4, 4)
    assert losses.silhouette_iou_loss(image, target).isnan() and losses.silhouette_iou_loss(target, image).isnan()
    assert losses.photometric(image[None], target[None]).isnan()


def test_mistakes_are_named():
    sparse = torch.ones(2, 4, 4).to_sparse()
    for call in (losses.silhouette_iou_loss, metrics.silhouette_iou):
        for pair in ((sparse, sparse), (torch.ones(2, 4, 4), sparse)):
            with pytest.raises(TypeError, match="expected a dense tensor, got"):
                call(*pair)
    with pytest.raises(TypeError, match="mask: expected a dense tensor"):
        losses.photometric(torch.rand(2, 3, 4, 4), torch.rand(2, 3, 4, 4), sparse)
    with pytest.raises(ValueError, match="faces: expected a tensor with numbers"):
        losses.laplacian(vertices(4), TETRAHEDRON.to("meta"))
    with pytest.raises(ValueError, match="target: expected shape"):
        losses.silhouette_iou_loss(torch.rand(2, 4, 4), torch.rand(1, 4, 4))
    with pytest.raises(ValueError, match="faces: expected whole numbers"):
        losses.laplacian(vertices(4), TETRAHEDRON / 2)
    with pytest.raises(ValueError, match="predicted and target"):
        metrics.silhouette_iou(torch.rand(2, 4, 4), torch.rand(2, 4, 5))


def test_they_compile_in_one_graph():
    topology = Topology.of(TETRAHEDRON)

    def loss(v, image):
        shape = losses.laplacian(v, topology) + losses.smoothness(v, topology) + losses.edge_length(v, topology)
        return shape + losses.silhouette_iou_loss(image[:, 0], image[:, 1]) + losses.total_variation(image, image[:, 2])

    v, image = vertices(2, 4), torch.rand(2, 3, 4, 4, dtype=torch.float64)
    torch.testing.assert_close(torch.compile(loss, fullgraph=True, backend="aot_eager")(v, image), loss(v, image))


@pytest.mark.slow
def test_losses_of_faces_compile_in_one_graph():
    """The number of edges depends on the values of the faces, so an operator finds them."""
    functions = losses.laplacian, losses.edge_length, losses.normal_consistency, losses.smoothness

    def each(points, faces):
        return torch.stack([loss(points, faces) for loss in functions])

    compiled, (start, faces) = torch.compile(each, fullgraph=True, backend="aot_eager"), nr.icosphere(1)
    for points in (start, start.expand(2, -1, -1)):
        points = points.clone().requires_grad_()
        torch.testing.assert_close(compiled(points, faces), each(points, faces))
        for i in range(len(functions)):
            gradients = (torch.autograd.grad(form(points, faces)[i], points)[0] for form in (compiled, each))
            torch.testing.assert_close(*gradients)


REDUCED = {
    "soft_iou_loss": lambda n: (torch.rand(n, 4, 5).double(), torch.rand(n, 4, 5).double()),
    "silhouette_iou_loss": lambda n: (torch.rand(n, 4, 5).double(), torch.rand(n, 4, 5).double()),
    "photometric": lambda n: (torch.rand(n, 3, 4, 5).double(), torch.rand(n, 3, 4, 5).double()),
    "photometric, mask": lambda n: (*torch.rand(2, n, 3, 4, 5).double(), torch.rand(n, 4, 5)),
    "total_variation": lambda n: (torch.rand(n, 3, 4, 5).double(),),
    "total_variation, mask": lambda n: (torch.rand(n, 3, 4, 5).double(), torch.rand(n, 4, 5)),
    "laplacian": lambda n: (vertices(n, 4), TETRAHEDRON),
    "edge_length": lambda n: (vertices(n, 4), TETRAHEDRON),
    "normal_consistency": lambda n: (vertices(n, 4), TETRAHEDRON),
    "smoothness": lambda n: (vertices(n, 4), TETRAHEDRON),
}


@pytest.mark.parametrize("name", REDUCED)
def test_losses_of_each_image(name):
    """ "none" gives what the loss of each image alone is; the others are its mean and sum."""
    loss, given = getattr(losses, name.partition(",")[0]), REDUCED[name](3)
    each = loss(*given, reduction="none")
    alone = [loss(*(part if part is TETRAHEDRON else part[i : i + 1] for part in given)) for i in range(3)]
    torch.testing.assert_close(each, torch.stack(alone))
    torch.testing.assert_close(loss(*given, reduction="sum"), each.sum())
    if name != "photometric, mask":
        torch.testing.assert_close(loss(*given, reduction="mean"), each.mean())
    default = "sum" if "variation" in name else "mean"
    assert torch.equal(loss(*given), loss(*given, reduction=default))
    nothing = [part if part is TETRAHEDRON else part[:0] for part in given]
    assert loss(*nothing, reduction="none").shape == (0,) and loss(*nothing, reduction="mean") == 0
    if given[-1] is TETRAHEDRON:
        assert loss(given[0][0], TETRAHEDRON, reduction="none").shape == ()
    with pytest.raises(ValueError, match="reduction: expected 'none', 'mean' or 'sum', got 'median'"):
        loss(*given, reduction="median")


def test_a_masked_mean_is_over_all_pixels():
    image, target, mask = torch.rand(2, 3, 4, 5), torch.rand(2, 3, 4, 5), torch.rand(2, 4, 5)
    expected = ((image - target).square().mean(1) * mask).sum() / mask.sum()
    torch.testing.assert_close(losses.photometric(image, target, mask), expected)


@pytest.mark.parametrize("name", ["laplacian", "edge_length", "normal_consistency", "smoothness"])
def test_batches_of_meshes_of_different_size(name: str) -> None:
    meshes = [mesh.trainable() for mesh in (nr.Mesh.icosphere(1), nr.Mesh.icosphere(2), nr.Mesh(*nr.cube()))]
    vertices, faces, _ = nr.batch(meshes)
    loss = getattr(nr.losses, name)
    expected = torch.stack([loss(mesh.vertices, mesh.faces) for mesh in meshes])
    torch.testing.assert_close(loss(vertices, faces, reduction="none"), expected)
    torch.testing.assert_close(loss(vertices, faces), expected.mean())
    torch.testing.assert_close(loss(vertices, faces, reduction="sum"), expected.sum())
    several, one = meshes[0].get_batch(4)[:2]
    torch.testing.assert_close(loss(several, one, reduction="none"), expected[:1].expand(4))
    loss(vertices, faces).backward()
    assert all(mesh.vertices.grad.any() for mesh in meshes[:2])
    with pytest.raises(ValueError, match="faces: expected"):
        loss(vertices[:2], faces)
    with pytest.raises(ValueError, match="faces: expected"):
        loss(vertices, faces.where(faces != 5, 999))
