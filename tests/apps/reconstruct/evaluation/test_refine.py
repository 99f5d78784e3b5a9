"""Test-time refinement: meshes are fitted to the silhouettes of their images."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from neural_renderer.apps.reconstruct.evaluation.predictors import network_predictor
from neural_renderer.apps.reconstruct.evaluation.refine import best_matching_views, refine_meshes
from neural_renderer.apps.reconstruct.networks.configs import Config
from neural_renderer.apps.reconstruct.networks.mesh_network import MeshNetwork
from neural_renderer.losses import silhouette_iou_loss
from tests.apps.reconstruct.synthetic import SMALL


def boats(network: MeshNetwork) -> Tensor:
    """Make two shapes [2, 642, 3] that look different from all 24 views."""
    x, y, z = network.sphere.unbind(1)
    first = torch.stack((x * 0.9, y * (0.3 + 0.4 * x), z * (0.35 - 0.3 * x)), 1)
    return torch.stack((first, first * torch.tensor([1.0, 1.4, 0.8])))


def grey_images(network: MeshNetwork, shapes: Tensor, views: Tensor) -> Tensor:
    """Render grey images [B, 4, 64, 64] of shapes."""
    alpha = network.silhouettes(shapes, views)
    return torch.cat((alpha[:, None].expand(-1, 3, -1, -1) * 0.5, alpha[:, None]), 1)


@pytest.mark.parametrize("symmetric", [True, False])
def test_the_silhouette_that_went_in(symmetric: bool) -> None:
    network = MeshNetwork(replace(SMALL, symmetric=symmetric, gradient="edge", anti_aliasing=False))
    truth, views = boats(network), torch.tensor([2, 17])
    images = grey_images(network, truth, views)
    guess = truth * torch.tensor([0.85, 1.2, 1.15])
    assert torch.equal(best_matching_views(network, guess, images[:, 3]), views)
    before = guess.clone()
    result = refine_meshes(network, guess, images, 20)
    assert torch.equal(guess, before) and not result.requires_grad and result.abs().max() <= 0.5

    def error(shapes: Tensor, views: Tensor) -> float:
        return float(silhouette_iou_loss(network.silhouettes(shapes, views), network.silhouettes(truth, views)))

    assert error(result, views) < 0.04 < 0.1 < error(guess, views)
    alone = refine_meshes(network, guess[:1], images[:1], 20)  # meshes are independent
    # A step moves vertices by up to a hundredth, along gradients that are the same but for their rounding.
    torch.testing.assert_close(alone, result[:1], rtol=0, atol=1e-4)
    if symmetric:  # the hidden side follows the visible one
        assert error(result, 12 - views) < 0.5 * error(guess, 12 - views)
        mirrored = result[:, network.partners] * torch.tensor([1.0, 1.0, -1.0])
        torch.testing.assert_close(mirrored, result)


def test_an_image_without_an_object_moves_nothing_far() -> None:
    network = MeshNetwork(replace(SMALL, gradient="edge"))
    guess = boats(network)
    result = refine_meshes(network, guess, torch.zeros(2, 4, 64, 64), 5)
    assert bool(result.isfinite().all()) and float((result - guess).abs().max()) < 0.1


def test_predictions_are_refined_as_often_as_asked() -> None:
    torch.manual_seed(0)
    network = MeshNetwork(Config(encoder="light", width=8, hidden=(16,), gradient="edge")).eval().requires_grad_(False)
    images = (grey_images(network, boats(network), torch.tensor([0, 5])) * 255).to(torch.uint8)
    vertices = network.vertices(images.float() / 255)
    plain, fitted = network_predictor(network)(images), network_predictor(network, refine=3)(images)
    torch.testing.assert_close(plain.vertices, vertices)  # type: ignore[attr-defined]
    expected = refine_meshes(network, vertices, images.float() / 255, 3)
    torch.testing.assert_close(fitted.vertices, expected)  # type: ignore[attr-defined]
