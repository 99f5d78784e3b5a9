"""Networks: published sizes, ranges of vertices, silhouettes of voxels."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps.common.features import googlenet, vgg
from neural_renderer.apps.reconstruct.data.framing import view_camera
from neural_renderer.apps.reconstruct.networks.checkpoint import make_network
from neural_renderer.apps.reconstruct.networks.configs import Config, make_config
from neural_renderer.apps.reconstruct.networks.encoders import FeatureEncoder, LightEncoder, PaperEncoder
from neural_renderer.apps.reconstruct.networks.mesh_network import (
    MeshDecoder,
    MeshNetwork,
    deform_sphere,
    smoothing_matrix,
)
from neural_renderer.apps.reconstruct.networks.voxel_network import VoxelNetwork, rays
from neural_renderer.meshes.topology import Topology
from tests.apps.features.test_features import torchvision_googlenet, torchvision_vgg
from tests.rounding import EPS, rounding

SMALL = Config(encoder="light", width=8, hidden=(16,))


def count(module: torch.nn.Module) -> int:
    return sum(value.numel() for value in module.parameters())


def test_published_sizes() -> None:
    assert count(PaperEncoder()) == 19_383_488
    assert count(MeshDecoder(642, (1024, 2048))) == 6_577_033


def test_octants() -> None:
    sphere = nr.icosphere(3)[0] * 0.5
    torch.manual_seed(0)
    still = deform_sphere(sphere, torch.zeros(1, 642, 3), torch.zeros(1, 3))
    torch.testing.assert_close(still[0], sphere / 2)
    for size in (0.3, 3.0, 100.0):
        bias, shift = torch.randn(4, 642, 3) * size, torch.randn(4, 3) * size
        moved = deform_sphere(sphere, bias, shift)
        assert moved.abs().max() <= 0.5
        corner = torch.tanh(shift)[:, None] / 2
        assert ((moved - corner) * sphere >= -4 * EPS).all()  # on the side of the octant's corner where it began
        on_plane = (sphere == 0).expand_as(moved)
        torch.testing.assert_close(moved[on_plane], corner.expand_as(moved)[on_plane])
    far = deform_sphere(sphere, torch.full((1, 642, 3), 50.0), torch.zeros(1, 3))
    torch.testing.assert_close(far[0], sphere.sign() / 2)


def test_symmetry() -> None:
    torch.manual_seed(0)
    network = MeshNetwork(replace(SMALL, symmetric=True)).eval()
    vertices = network.vertices(torch.rand(2, 4, 64, 64))
    mirrored = vertices * torch.tensor([1.0, 1.0, -1.0])
    torch.testing.assert_close(mirrored[:, network.partners], vertices)
    assert sorted(network.partners.tolist()) == list(range(642))


def test_blurring() -> None:
    """The matrix solves (1 + λL) x = y; it keeps constants and spreads single values."""
    vertices, faces = nr.icosphere(2)
    matrix = smoothing_matrix(Topology.of(faces), 3.0)
    generator = torch.Generator().manual_seed(0)
    noise = torch.randn(len(vertices), 3, generator=generator)
    blurred = matrix @ noise
    edges = Topology.of(faces).edges
    differences = blurred[edges[:, 0]] - blurred[edges[:, 1]]
    laplacian = torch.zeros_like(blurred).index_add(0, edges[:, 0], differences).index_add(0, edges[:, 1], -differences)
    # The matrix inverts one of a condition below 1 + 3 x 12, twice the largest degree; its rows have 162 entries.
    torch.testing.assert_close(blurred + 3 * laplacian, noise, **rounding(162 * 37, 4 / 162**0.5))
    torch.testing.assert_close(matrix.sum(1), torch.ones(len(vertices)), **rounding(162 + 37))
    assert torch.equal(smoothing_matrix(Topology.of(faces), 0.0), torch.eye(len(vertices)))


def test_blurred_meshes_are_smooth() -> None:
    """Smoothing changes the prediction, but has no weights."""
    meshes = []
    for blur in (0.0, 3.0):
        torch.manual_seed(0)
        network = MeshNetwork(replace(SMALL, blur=blur))
        assert "blur" not in network.state_dict()
        meshes.append(network.vertices(torch.rand(2, 4, 64, 64, generator=torch.Generator().manual_seed(1))))
    rough, smooth = (nr.losses.normal_consistency(vertices, network.faces) for vertices in meshes)
    assert smooth < 0.1 * rough


@pytest.mark.parametrize("encoder", [PaperEncoder, lambda: LightEncoder(8)])
def test_a_picture_alone_counts(encoder: type[torch.nn.Module]) -> None:
    torch.manual_seed(0)
    network, images = encoder().eval(), torch.rand(3, 4, 64, 64)
    features = network(images)
    assert features.shape == (3, 512)
    # Convolutions of other batches are summed in other orders: up to 25 x 512 terms a layer, mostly of both signs.
    torch.testing.assert_close(network(images[1:2]), features[1:2], **rounding(25 * 512, float(features.abs().max())))


def test_voxels_are_seen_where_their_points_are() -> None:
    """The silhouettes of an off-centre ball of voxels equal the renderer's in every view, to half a pixel."""
    centre, radius = torch.tensor([0.12, -0.2, 0.25]), 0.2
    middle = (torch.arange(32) - 15.5) / 31
    y, x, z = torch.meshgrid(middle, middle, -middle, indexing="ij")  # the axes of the published voxels
    distance = (torch.stack((x, y, z), -1) - centre).norm(dim=-1)
    solid = ((radius - distance) * 31 + 0.5).clamp(0, 1)
    views = torch.arange(24)
    network = VoxelNetwork(SMALL)
    drawn = network.silhouettes(solid.expand(24, -1, -1, -1), views)
    vertices, faces = nr.icosphere(3)
    target = nr.render((vertices * radius + centre, faces), view_camera(views), 32, outputs="alpha").alpha
    assert target is not None and nr.metrics.silhouette_iou(drawn, target).min() > 0.85
    assert rays(torch.device("cpu")).shape == (24, 32, 32, 32, 3)


@pytest.mark.parametrize("kind", ["mesh", "voxel"])
def test_gradients_reach_every_weight(kind: str) -> None:
    torch.manual_seed(0)
    network = make_network(kind, replace(SMALL, smoothness=1e-3, laplacian=1.0, blur=1.0))
    shapes = network(torch.rand(2, 4, 64, 64))
    drawn = network.silhouettes(shapes, torch.tensor([3, 11]))
    target = torch.zeros_like(drawn)
    target[:, 10:20, 8:14] = 1
    (nr.losses.silhouette_iou_loss(drawn, target) + network.regularizer(shapes)).backward()
    for name, value in network.named_parameters():
        assert value.grad is not None and torch.isfinite(value.grad).all() and value.grad.abs().max() > 0, name


def test_configurations() -> None:
    assert make_config("paper", ["a", "b"]) == Config()
    single = make_config("paper", ["chair"])
    assert (single.smoothness, single.steps) == (1e-3, 250_000) == (1e-3, make_config("paper", ["03001627"]).steps)
    for name in ("paper", "small", "best"):
        config = make_config(name, ["a", "b"])  # type: ignore[arg-type]
        assert Config.from_dict(config.to_dict()) == config
    with pytest.raises(ValueError, match="config: expected the fields of a configuration, got also wings"):
        Config.from_dict({"wings": 2})
    with pytest.raises(ValueError, match="model: expected one of mesh, voxel, got 'cloud'"):
        make_network("cloud", Config())


def test_features() -> None:
    """Colours of transparent pixels do not matter, and pretrained weights do not change."""
    network = googlenet(torchvision_googlenet())
    encoder = FeatureEncoder(network)
    images = torch.rand(3, 4, 64, 64, generator=torch.Generator().manual_seed(0))
    images[:, 3] = (images[:, 3] > 0.5).float()
    features = encoder(images)
    assert (
        features.shape == (3, 512) and encoder.layer == "inception_4c" and encoder.features.layers[-1] == "inception_4c"
    )
    on_white = torch.cat((torch.where(images[:, 3:] > 0, images[:, :3], 1.0), torch.ones_like(images[:, 3:])), 1)
    torch.testing.assert_close(encoder(on_white), features)
    alone = encoder(images[:1])  # whatever else is in the batch
    torch.testing.assert_close(alone, features[:1], **rounding(25 * 512, float(features.detach().abs().max())))
    features.sum().backward()
    assert {name for name, value in encoder.named_parameters() if value.grad is not None} == {
        "learned.1.weight",
        "learned.1.bias",
    }
    assert FeatureEncoder(vgg(torchvision_vgg(16))).layer == "conv4_3"
    with pytest.raises(ValueError, match="features: expected a network with inception_4c or conv4_3, got GoogLeNet"):
        FeatureEncoder(network.until("pool3"))
    with pytest.raises(ValueError, match='features: expected a network for the encoder "features", got None'):
        make_network("mesh", replace(SMALL, encoder="features"))
