"""Photographs with a model of COLMAP, loaded as a user has them."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from PIL import Image

import neural_renderer as nr
from neural_renderer.apps.fit import Views, load_views, object_bounds

K = torch.tensor([[75.0, 0.0, 33.0], [0.0, 74.0, 23.0], [0.0, 0.0, 1.0]])
CENTER = torch.tensor([4.0, -2.0, 7.0])  # worlds of COLMAP begin anywhere


def thing() -> nr.Mesh:
    vertices, faces = nr.icosphere(2)
    return nr.Mesh(vertices * torch.tensor([0.8, 0.4, 0.6]) + CENTER, faces)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Write six photographs on white, and their model in text files."""
    elevation = torch.tensor([70.0, 10.0, -35.0, 20.0, 40.0, -5.0])
    eyes = nr.get_points_from_angles(3.2, elevation, torch.arange(6) * 60.0 + 20.0) + CENTER
    looking = nr.Camera.look_at(eyes, CENTER)
    R = looking.rotation * torch.tensor([1.0, -1.0, 1.0])[:, None]
    t = -torch.einsum("bij,bj->bi", R, eyes)
    views = Views.of(thing(), nr.Camera.projection(K, R, t, orig_size=(48, 64)), (48, 64))
    (tmp_path / "images" / "left").mkdir(parents=True)
    model = tmp_path / "sparse" / "0"
    model.mkdir(parents=True)
    lines = []
    for index in range(6):
        name = f"left/{index}.png"
        alpha = views.masks[index]
        nr.save_image(tmp_path / "images" / name, 0.4 * views.photos[index] + 1 - alpha)  # type: ignore[index]
        w = (1 + torch.trace(R[index])).clamp(min=0).sqrt() / 2
        a = R[index]
        x, y, z = (a[2, 1] - a[1, 2]) / (4 * w), (a[0, 2] - a[2, 0]) / (4 * w), (a[1, 0] - a[0, 1]) / (4 * w)
        numbers = [float(value) for value in (w, x, y, z, *t[index])]
        lines += [f"{index + 1} {' '.join(map(str, numbers))} 1 {name}", ""]
    (model / "images.txt").write_text("# images\n" + "\n".join(lines))
    (model / "cameras.txt").write_text("1 PINHOLE 640 480 750 740 330 230\n")
    points = torch.cat((thing().vertices.detach(), CENTER + torch.tensor([[9.0, 9.0, 9.0]])))
    (model / "points3D.txt").write_text("\n".join(f"{i} {x} {y} {z} 0 0 0 1" for i, (x, y, z) in enumerate(points)))
    return tmp_path


def test_photographs_with_a_model_of_colmap(folder: Path) -> None:
    views, mesh = load_views(folder), thing()
    # The masks are found on white and not those of the renderer: pixels at outlines differ.
    assert views.quality((mesh.vertices.detach(), mesh.faces))["iou"].min() > 0.9
    assert views.region is not None and (views.region[0] - CENTER).abs().max() < 0.05
    center, half = object_bounds(views)
    assert (center - CENTER).abs().max() < 0.1 and abs(half - 0.8) < 0.15


def test_photographs_that_a_viewer_turned(folder: Path) -> None:
    """The pixels are stored lying down, and EXIF says so; the calibration is that of the upright image."""
    plain = load_views(folder)
    for path in (folder / "images" / "left").iterdir():
        with Image.open(path) as picture:
            lying = picture.transpose(Image.Transpose.ROTATE_90)
        exif = Image.Exif()
        exif[0x0112] = 6  # turn clockwise to show
        lying.save(path, exif=exif)
    torch.testing.assert_close(load_views(folder).masks, plain.masks)


def test_fisheye_images_are_undistorted(folder: Path) -> None:
    """Where the lens has no distortion, undistorted images are the images."""
    plain = load_views(folder)
    model = folder / "sparse" / "0" / "cameras.txt"
    model.write_text("1 FULL_OPENCV 640 480 750 740 330 230 0 0 0 0 0 1e-9 0 0\n")
    torch.testing.assert_close(load_views(folder).masks, plain.masks, rtol=0, atol=1e-3)
    model.write_text("1 SIMPLE_FISHEYE 640 480 750 330 230\n")
    bent = load_views(folder)
    assert bent.camera.dist_coeffs is None and (bent.masks.sum() > plain.masks.sum())  # a fisheye makes rims smaller


def test_images_that_are_missing(folder: Path) -> None:
    (folder / "images" / "left" / "2.png").unlink()
    with pytest.raises(FileNotFoundError, match=r"images\.txt: expected a file 'left/2\.png', got nothing there"):
        load_views(folder)
    text = (folder / "sparse/0/images.txt").read_text()
    (folder / "sparse/0/images.txt").write_text(text.replace("left/2.png", "../../secret.png"))
    (folder.parent / "secret.png").write_bytes(b"")
    with pytest.raises(ValueError, match="allow_outside=True"):
        load_views(folder)
