"""Estimators are objects: the ones with names, and one that a program adds."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.raster.colors.downsample import averaged
from neural_renderer.raster.visibility.estimators import ESTIMATORS, DrawnFaces, Estimator, estimator


class InsideOnly(Estimator):
    """No gradient through visibility, but the derivatives inside faces."""

    differentiates_inside = True

    def attach(
        self,
        image: Tensor | None,
        drawn: DrawnFaces,
        seams: bool = False,
        edge_hashes: Callable[[], Tensor] | None = None,
    ) -> Tensor:
        return averaged(image, drawn.face_index, drawn.halved)


def ball() -> tuple[nr.UVMesh, nr.Camera]:
    vertices, faces = nr.icosphere(2)
    mesh = nr.UVMesh(vertices, faces, vertices[:, :2].clone(), torch.rand(8, 8, 3, generator=torch.Generator()))
    return mesh, nr.Camera.look_at(eye=(0.3, 0.2, -2.7))


@pytest.mark.parametrize("by_name", [False, True])
@pytest.mark.parametrize("layers", [1, 2])
def test_one_that_a_program_adds(monkeypatch: pytest.MonkeyPatch, by_name: bool, layers: int) -> None:
    monkeypatch.setitem(ESTIMATORS, "inside only", InsideOnly())
    mesh, camera = ball()
    mesh.vertices.requires_grad_()
    images = nr.render(mesh, camera, 32, gradient="inside only" if by_name else InsideOnly(), layers=layers)
    expected = nr.render(mesh, camera, 32, gradient="edge", layers=layers)
    assert torch.equal(images.rgb, expected.rgb)
    assert not images.alpha.requires_grad  # silhouettes change by visibility alone
    [gradient] = torch.autograd.grad(images.rgb.sum(), mesh.vertices)
    assert gradient.any()


class Weighted(InsideOnly):
    """An estimator with a number."""

    def __init__(self, weight: float) -> None:
        self.weight = weight


def test_names() -> None:
    assert [repr(estimator(name)) for name in ESTIMATORS] == ["'nmr'", "'edge'", "'opendr'"]
    assert Weighted(1) == Weighted(1) != Weighted(2) and repr(Weighted(1)) == "Weighted"
    with pytest.raises(ValueError, match="an instance is needed, not the class"):
        estimator(InsideOnly)
    with pytest.raises(ValueError, match="gradient: expected one of nmr, edge, opendr, got 'soft'"):
        nr.rasterize_images(torch.zeros(1, 1, 3, 3), 8, outputs=("alpha",), gradient="soft")
