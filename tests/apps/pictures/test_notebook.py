"""Pictures in notebooks: `neural_renderer.apps.common.pictures.notebook`."""

from __future__ import annotations

import io
import math

import pytest
import torch
from PIL import Image

import neural_renderer as nr
from neural_renderer.apps.common.pictures.notebook import fragments_png, images_png, mesh_png

CAMERA = nr.Camera.look_at(nr.get_points_from_angles(2.7, 20.0, torch.tensor([30.0, 120.0])), viewing_angle=30)


def opened(png: bytes | None) -> Image.Image:
    assert png is not None
    return Image.open(io.BytesIO(png))


def pixels(png: bytes | None) -> torch.Tensor:
    image = opened(png).convert("RGB")
    return torch.tensor(list(image.tobytes())).view(image.height, image.width, 3)


def test_images_show_colour_silhouette_and_depth_below_each_other() -> None:
    images = nr.render(nr.Mesh.icosphere(1), CAMERA, 128)
    shown = pixels(images._repr_png_())  # type: ignore[attr-defined]
    assert shown.shape == (3 * 128, 2 * 128, 3)
    for row, layer in ((0, images.rgb), (1, images.alpha[:, None].expand(-1, 3, -1, -1))):  # type: ignore[union-attr, index]
        for column in range(2):
            tile = shown[128 * row : 128 * (row + 1), 128 * column : 128 * (column + 1)]
            assert torch.equal(tile, (layer[column].detach().clamp(0, 1) * 255).round().long().permute(1, 2, 0))  # type: ignore[index]
    depth = shown[256:, :128, 0]
    assert depth[0, 0] == 0  # nothing there
    assert depth.max() == 255  # the nearest point
    assert depth[64, 64] > depth[64, 100] > 0  # a sphere is nearest in its middle


def test_small_images_are_enlarged_and_wide_rows_reduced() -> None:
    assert opened(images_png(nr.Images(alpha=torch.rand(1, 16, 24)))).size == (24 * 8, 128)
    assert opened(images_png(nr.Images(alpha=torch.rand(4, 300, 600)))).size == (1024, 128)
    assert opened(images_png(nr.Images(alpha=torch.rand(100, 128, 128)))).size == (1024, 128)  # the first eight


def test_numbers_that_are_not_colours_are_shown_as_black_or_white() -> None:
    values = torch.tensor([[math.nan, -1.0, 2.0, math.inf]]).expand(128, 4)
    assert pixels(images_png(nr.Images(alpha=values[None])))[0, :, 0].tolist() == [0, 0, 255, 255]


@pytest.mark.parametrize("images", [nr.Images(), nr.Images(rgb=torch.zeros(0, 3, 8, 8))])
def test_without_pixels_there_is_no_picture(images: nr.Images) -> None:
    assert images_png(images) is None


@pytest.mark.parametrize("anti_aliasing", [True, False])
def test_fragments_are_a_map_with_one_colour_for_each_face(anti_aliasing: bool) -> None:
    mesh = nr.Mesh(*nr.cube())
    fragments = nr.fragments(mesh, CAMERA, 128, anti_aliasing=anti_aliasing)
    shown = pixels(fragments_png(fragments))
    assert shown.shape == (128, 256, 3)
    scale = 2 if anti_aliasing else 1
    index = torch.cat(list(fragments.face_index[:, ::scale, ::scale]), 1)
    colors = {face: shown[index == face].unique(dim=0) for face in index.unique().tolist()}
    assert all(len(found) == 1 for found in colors.values())
    assert len({tuple(found[0].tolist()) for found in colors.values()}) == len(colors)
    assert colors[-1].tolist() == [[255, 255, 255]]


def test_a_mesh_is_a_turntable_wherever_it_lies() -> None:
    vertices, faces = nr.icosphere(1)
    turntable = opened(mesh_png(nr.Mesh(1000 + 5 * vertices, faces, torch.rand(len(faces), 2, 2, 2, 3))))
    assert turntable.size == (192, 192) and turntable.n_frames == 20 and turntable.info["loop"] == 0


def test_a_mesh_without_size_is_shown_as_text() -> None:
    assert mesh_png(nr.Mesh(torch.zeros(3, 3), torch.tensor([[0, 1, 2]]))) is None


def test_the_caller_s_mesh_and_its_gradients_stay() -> None:
    mesh = nr.Mesh.icosphere(0).trainable()
    before = mesh.vertices.clone()
    mesh._repr_png_()  # type: ignore[operator]
    assert torch.equal(mesh.vertices, before) and mesh.vertices.grad is None and mesh.vertices.requires_grad
