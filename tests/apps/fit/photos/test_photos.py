"""Photographs alone: copies, frames of videos, the place of the object, its masks, and pieces of a reconstruction."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.fit import MaskRule
from neural_renderer.apps.fit.commands.cameras import _remove_empty, photographs_beside
from neural_renderer.apps.fit.doubts import SECOND
from neural_renderer.apps.fit.photos import copy_photographs, find_cameras, find_masks, motion, pairs, write_known_masks
from neural_renderer.apps.fit.photos.copies import turns_of
from neural_renderer.apps.fit.photos.masks import object_masks, voxels
from neural_renderer.apps.fit.photos.masks.mask_sheet import mask_sheet
from neural_renderer.apps.fit.photos.masks.shape_masks import ShapeMasks
from neural_renderer.apps.fit.photos.masks.surroundings import _moves_as_one, inside_mask
from neural_renderer.apps.fit.photos.missing import displaced, only_turned
from neural_renderer.apps.fit.photos.motion import _find_features, mapping_options
from neural_renderer.apps.fit.photos.pairs import Agreement
from neural_renderer.apps.fit.photos.pieces import join_pieces
from neural_renderer.apps.fit.photos.place import FLAT, find_ground, find_place
from neural_renderer.apps.fit.photos.video import choose_frames, sharpness
from neural_renderer.camera.files import CameraFile, read_camera_file
from neural_renderer.camera.files.opencv import save_cameras
from tests.rounding import STEP


def quiet(phase: str, done: int, total: int) -> None:
    """Ignore the progress."""


def photograph(path: Path, size: tuple[int, int], orientation: int = 1, focal: int = 0) -> None:
    """Write a photograph of noise with EXIF data."""
    path.parent.mkdir(parents=True, exist_ok=True)
    width, height = size
    pixels = np.random.default_rng(0).integers(0, 255, (height, width, 3), np.uint8)
    exif = Image.Exif()
    exif[0x0112] = orientation
    if focal:
        exif.get_ifd(0x8769)[0xA405] = focal
    Image.fromarray(pixels).save(path, exif=exif)


def test_copies_stand_upright_if_that_gives_them_one_shape(tmp_path: Path) -> None:
    photograph(tmp_path / "in" / "a.jpg", (64, 48), 6, focal=28)
    photograph(tmp_path / "in" / "b.jpg", (128, 96), 6)
    (tmp_path / "in" / "c.jpg").write_bytes(b"no picture")
    copies = copy_photographs(tmp_path / "in", tmp_path / "out", 60, quiet)
    assert copies.names == ["a.jpg", "b.jpg"]
    assert list(copies.refused) == ["c.jpg"]
    for name in copies.names:
        with Image.open(tmp_path / "out" / "images" / name) as image:
            assert image.size == (48, 64)
            assert image.getexif()[0x0112] == 1
            assert image.getexif().get_ifd(0x8769).get(0xA405) == (28 if name == "a.jpg" else None)
    before = (tmp_path / "out" / "images" / "a.jpg").stat().st_mtime_ns
    assert copy_photographs(tmp_path / "in", tmp_path / "out", 60, quiet) == copies
    assert (tmp_path / "out" / "images" / "a.jpg").stat().st_mtime_ns == before


@pytest.mark.parametrize(
    "size, orientation, copy, focal",
    [
        ((4000, 3000), 1, (1600, 1200), 1999.6),
        ((4000, 3000), 6, (1200, 1600), 1999.6),
        ((2000, 1500), 1, (1600, 1200), 1999.6),  # reduced before, with the EXIF data of the whole photograph
        ((3000, 3000), 1, (1600, 1600), 4999 * 1600 / 3000),  # cut
    ],
)
def test_copies_keep_the_focal_length_that_pixels_of_the_sensor_give(
    tmp_path: Path, size: tuple[int, int], orientation: int, copy: tuple[int, int], focal: float
) -> None:
    """10 mm at 499.9 pixels per millimetre are 4999 pixels of the whole photograph, of 4000 by 3000."""
    colmap = pytest.importorskip("pycolmap")
    (tmp_path / "in").mkdir()
    exif, fraction = Image.Exif(), IFDRational(4999, 10)
    exif[0x0112] = orientation
    lens = {0x920A: IFDRational(10), 0xA002: 4000, 0xA003: 3000, 0xA20E: fraction, 0xA20F: fraction, 0xA210: 4}
    exif.get_ifd(0x8769).update(lens)
    Image.new("RGB", size).save(tmp_path / "in/a.jpg", exif=exif)
    copy_photographs(tmp_path / "in", tmp_path / "out", 60, quiet)
    with Image.open(tmp_path / "out/images/a.jpg") as image:
        assert image.size == copy
    found = colmap.infer_camera_from_image(tmp_path / "out/images/a.jpg")
    assert found.has_prior_focal_length and found.focal_length == pytest.approx(focal, rel=1e-6)


def test_copies_of_both_orientations_stay_as_the_sensor_has_them(tmp_path: Path) -> None:
    photograph(tmp_path / "a.jpg", (64, 48), 6)
    photograph(tmp_path / "b.jpg", (64, 48), 1)
    photograph(tmp_path / "c.jpg", (64, 32), 1)
    copies = copy_photographs(tmp_path, tmp_path / "out", 60, quiet)
    for name in copies.names:
        with Image.open(tmp_path / "out" / "images" / name) as image:
            assert image.size == (64, 48), "narrower pictures are continued"
    # Masks of the photographs, not of the copies: upright, and without the borders that were added.
    tall, wide = torch.zeros(64, 48), torch.zeros(32, 64)
    tall[:16, :24] = 1  # upper left; the sensor, turned to the right to stand upright, has it at the lower left
    wide[:16, :16] = 1
    nr.save_image(tmp_path / "masks" / "a.png", tall)
    nr.save_image(tmp_path / "masks" / "c.png", wide)
    write_known_masks(copies, [tmp_path / "masks"], MaskRule(), quiet)
    masks = tmp_path / "out" / "masks"
    lying, padded = (nr.load_image(masks / f"{name}.jpg.png")[..., 0] for name in ("a", "c"))
    assert lying[24:, :16].min() == 1 and lying.sum() == 24 * 16
    assert padded[8:24, :16].min() == 1 and padded.sum() == 16 * 16
    assert turns_of(tmp_path / "out") == {"a.jpg": 6}
    files = [tmp_path / "out" / "images" / name for name in ("a.jpg", "b.jpg")]
    drawn = mask_sheet(files, masks, turns_of(tmp_path / "out")).float() / 255
    green = drawn[:64, :64, 1]  # which the tint of what is outside has little of
    assert green[1:15, 9:31].mean() > 0.4 and green[20:60, 10:54].mean() < 0.3 and bool((green[:, :7] == 1).all())


def test_a_picture_much_smaller_than_the_others_is_left_out(tmp_path: Path) -> None:
    for name, size in (("a.jpg", (96, 64)), ("b.jpg", (64, 96)), ("c.jpg", (48, 40)), ("thumb.jpg", (40, 30))):
        photograph(tmp_path / name, size)
    copies = copy_photographs(tmp_path, tmp_path / "out", 60, quiet)
    assert copies.names == ["a.jpg", "b.jpg", "c.jpg"]
    assert list(copies.refused) == ["thumb.jpg"]
    assert copies.refused["thumb.jpg"].startswith("40 × 30 pixels, where others have ")
    assert not (tmp_path / "out" / "images" / "thumb.jpg").exists()


def test_other_photographs_replace_earlier_copies(tmp_path: Path) -> None:
    photograph(tmp_path / "a.jpg", (64, 48))
    copy_photographs(tmp_path, tmp_path / "out", 60, quiet)
    (tmp_path / "out" / "database.db").write_bytes(b"features of others")
    photograph(tmp_path / "b.jpg", (64, 48))
    assert copy_photographs(tmp_path, tmp_path / "out", 60, quiet).names == ["a.jpg", "b.jpg"]
    assert not (tmp_path / "out" / "database.db").exists()


def test_photographs_and_images_of_others_are_never_replaced(tmp_path: Path) -> None:
    photograph(tmp_path / "images" / "a.jpg", (64, 48))
    before = (tmp_path / "images" / "a.jpg").read_bytes()
    photograph(tmp_path / "other" / "a.jpg", (32, 24))
    with pytest.raises(FileExistsError, match="images of others"):
        copy_photographs(tmp_path / "other", tmp_path, 60, quiet)
    assert (tmp_path / "images" / "a.jpg").read_bytes() == before


def test_results_lie_apart_from_the_photographs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pycolmap")
    inside, nested = tmp_path / "inside", tmp_path / "nested"
    photograph(inside / "a.jpg", (64, 48))
    photograph(nested / "images" / "a.jpg", (64, 48))
    for source, out in (
        (inside, inside),
        (inside, inside / "images"),
        (inside, inside / "colmap"),
        (nested, nested),
        (nested / "images", nested),
    ):
        assert cli.main(["fit", str(source), "-o", str(out)]) == 1
        assert capsys.readouterr().err == f"--output: expected a folder apart from the photographs, got {out}\n"
    files = [file for file in tmp_path.rglob("*") if file.is_file()]
    assert sorted(files) == [inside / "a.jpg", nested / "images" / "a.jpg"]
    for _ in range(2):
        assert copy_photographs(inside, inside / "out", 60, quiet).names == ["a.jpg"]


def test_videos_among_photographs_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pycolmap")
    command = ["fit", str(tmp_path), "-o", str(tmp_path / "out")]
    (tmp_path / "clip.mp4").write_bytes(b"")
    assert cli.main(command) == 1
    assert capsys.readouterr().err.endswith(f", got a video; give its path, {tmp_path / 'clip.mp4'}\n")
    photograph(tmp_path / "a.jpg", (64, 48))
    (tmp_path / "last.MOV").write_bytes(b"")
    assert cli.main(command) == 1
    told = capsys.readouterr().err.splitlines()
    assert told[0] == "clip.mp4 is not used (nor 1 more): a video is given by its path, without other photographs"
    assert told[1].startswith("expected at least 3 photographs")


def test_blur_lowers_sharpness() -> None:
    grey = np.random.default_rng(0).random((64, 64), np.float32) * 255
    blurred = np.asarray(Image.fromarray(grey.astype(np.uint8)).resize((16, 16)).resize((64, 64)), np.float32)
    assert sharpness(blurred) < 0.5 * sharpness(grey)


def test_frames_are_spaced_by_change(tmp_path: Path) -> None:
    ramp = torch.rand(1, 32, 96, generator=torch.Generator().manual_seed(0)).expand(3, -1, -1)
    still, moving = [ramp[..., :64]] * 20, [ramp[..., shift : shift + 64] for shift in range(20)]
    nr.save_animation(tmp_path / "clip.mp4", [*still, *moving], fps=10)
    chosen = list(choose_frames(tmp_path / "clip.mp4", 8, 48))
    assert sum(seconds >= 1.9 for _, seconds, _ in chosen) >= len(chosen) - 1, "the still part counts once"
    assert all(frame.shape == (24, 48, 3) and frame.dtype == np.uint8 for *_, frame in chosen)
    (tmp_path / "broken.mp4").write_bytes(b"no video")
    with pytest.raises(ValueError, match=r"broken.mp4: expected a video, got one that cannot be read \("):
        next(choose_frames(tmp_path / "broken.mp4", 8, 48))


def scene(folder: Path, size: int = 96, second: bool = False) -> tuple[CameraFile, list[torch.Tensor]]:
    """Write photographs of a ball on a patterned table; return their cameras, with points, and the true masks.

    A second, smaller ball may lie beside it, which the masks leave out.
    """
    eyes = nr.get_points_from_angles(4.0, torch.tensor([25.0, 50.0] * 4), torch.arange(8) * 45.0)
    camera = nr.Camera.look_at(eyes, viewing_angle=22.0)
    rng = torch.Generator().manual_seed(0)
    corners = torch.tensor([[-3.0, -0.6, -3.0], [-3.0, -0.6, 3.0], [3.0, -0.6, 3.0], [3.0, -0.6, -3.0]])
    uv = torch.tensor([[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]])
    pattern = torch.rand(40, 40, 3, generator=rng) * 0.3 + torch.tensor([0.1, 0.5, 0.1])
    table = nr.UVMesh(corners, torch.tensor([[0, 1, 2], [0, 2, 3]]), uv, pattern)
    vertices, faces = nr.icosphere(3, 0.6)
    ball = nr.Mesh(vertices, faces, vertex_colors=torch.tensor([[0.95, 0.55, 0.15]]).expand(len(vertices), 3))
    below, above = (nr.render(mesh, camera, size, light=None) for mesh in (table, ball))
    images = above.rgb + below.rgb * (1 - above.alpha[:, None])
    if second:
        aside = nr.Mesh(vertices * 0.6 + torch.tensor([1.1, -0.2, 0.0]), faces, vertex_colors=ball.vertex_colors)
        both = nr.render(aside, camera, size, light=None)
        images = both.rgb + images * (1 - both.alpha[:, None])
    names = [f"{number}.png" for number in range(8)]
    for name, image in zip(names, images, strict=True):
        nr.save_image(folder / "images" / name, image)
    save_cameras(folder / "cameras.json", camera, names, (size, size))
    flat = torch.rand(200, 3, generator=rng) * 3 - 1.5
    flat[:, 1] = -0.6
    directions = torch.nn.functional.normalize(torch.randn(60, 3, generator=rng), dim=1)
    points = torch.cat((flat, 0.6 * directions)).double()
    cameras = read_camera_file(folder / "cameras.json")
    return replace(cameras, folders=(folder / "images",), points=points), list(above.alpha)


def test_place_is_above_the_table(tmp_path: Path) -> None:
    cameras, _ = scene(tmp_path)
    assert cameras.points is not None
    place = find_place(cameras.cameras((96, 96)), cameras.points, (96, 96))
    assert place.ground is not None
    np.testing.assert_allclose(place.ground, [0, 1, 0, -0.6], atol=1e-3)  # some points of the ball lie near it
    assert np.linalg.norm(place.center) < 0.2
    assert 0.6 < place.half < 1.2
    assert (place.points[:, 1] > -0.6).all()


def test_a_table_that_the_object_hides_is_found_around_it() -> None:
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(4000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    angle, far = rng.uniform(0, 2 * np.pi, 500), rng.uniform(1.5, 3, 500)
    table = np.stack((far * np.cos(angle), np.full(500, -0.9), far * np.sin(angle)), 1)
    reach, eyes = 1.1, np.array([[3.0, 1, 0], [-3.0, 1, 0], [0, 1, 3.0]])
    assert find_ground(ball, eyes, np.zeros(3), reach) is None
    ground = find_ground(np.concatenate((ball, table)), eyes, np.zeros(3), reach)
    assert ground is not None
    np.testing.assert_allclose(ground, [0, 1, 0, -0.9], atol=3 * FLAT * reach)  # points of the ball may lie so near
    below = table - [0, 2 * reach, 0]  # a floor, on which it does not stand
    assert find_ground(np.concatenate((ball, below)), eyes, np.zeros(3), reach) is None


def test_a_pillar_may_leave_the_picture_and_a_wall_may_not() -> None:
    masks = np.zeros((3, 40, 30), bool)
    masks[:, 10:, 5:25] = True
    assert object_masks._are_whole(masks)
    masks[:, 10:20] = True
    assert not object_masks._are_whole(masks)


@pytest.mark.slow
def test_masks_of_an_object_on_a_table(tmp_path: Path) -> None:
    cameras, true = scene(tmp_path)
    found = find_masks(cameras, tmp_path, quiet)
    assert found.reason is None and found.second < 0.1
    for number, alpha in enumerate(true):
        mask = nr.load_image(tmp_path / "masks" / f"{number}.png.png")[..., 0] > 0.5
        inside = alpha > 0.5
        assert float((mask & inside).sum() / (mask | inside).sum()) > 0.9


@pytest.mark.slow
def test_two_objects_on_a_table_are_told(tmp_path: Path) -> None:
    cameras, _ = scene(tmp_path, second=True)
    assert cameras.points is not None
    aside = cameras.points[-60:] * 0.6 + torch.tensor([1.1, -0.2, 0.0]).double()
    found = find_masks(replace(cameras, points=torch.cat((cameras.points, aside))), tmp_path, quiet)
    assert found.reason is None and found.second > SECOND


def no_shape(*_: object) -> ShapeMasks:
    """Say that depth shows nothing, so that colours decide."""
    return ShapeMasks(None, None, None, "no depth", False, 0.0, torch.zeros(0, 3))


def test_colours_fill_holes_of_masks_by_depth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cameras, true = scene(tmp_path)
    whole = torch.stack(true).numpy() > 0.5
    thin, handle = whole.copy(), whole.copy()
    thin[:, 44:52, 36:52] = False  # a hole, of which the right half shows the background
    handle[:, 44:52, 44:52] = False
    moved = np.arange(8) == 2
    shape = ShapeMasks(thin, None, None, None, True, 0.0, torch.zeros(0, 3), None, moved)
    monkeypatch.setattr(object_masks, "masks_of_shape", lambda *_: shape)
    monkeypatch.setattr(object_masks, "contradiction", lambda masks, *_: float(masks is not thin))
    monkeypatch.setattr(object_masks, "_masks_of_colors", lambda images, *_: (handle[: len(images)], 0.0))
    found = find_masks(cameras, tmp_path, quiet)
    assert found.reason is None and found.moved == {"2.png"}
    assert sorted(file.name[0] for file in (tmp_path / "masks").iterdir()) == list("0134567")
    for number in (0, 7):
        mask = nr.load_image(tmp_path / "masks" / f"{number}.png.png")[..., 0] > 0.5
        assert mask[45:51, 37:43].all() and not mask[46:50, 46:50].any()


def test_masks_that_reach_over_the_border_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cameras, _ = scene(tmp_path)
    for module, name, value in (
        (object_masks, "_ROUNDS", 1),
        (voxels, "_CELLS", 24),
        (object_masks, "_MOST_BORDER", -1),
    ):
        monkeypatch.setattr(module, name, value)
    monkeypatch.setattr(object_masks, "masks_of_shape", no_shape)
    assert find_masks(cameras, tmp_path, quiet).reason == "the masks found reach over the border of most photographs"
    assert len(list((tmp_path / "masks").iterdir())) == 8


def test_empty_masks_show_no_object(tmp_path: Path) -> None:
    nr.save_image(tmp_path / "a.jpg.png", torch.zeros(32, 32))
    nr.save_image(tmp_path / "b.jpg.png", torch.ones(32, 32))
    assert _remove_empty(tmp_path, ["a.jpg", "b.jpg", "c.jpg"]) == 1
    assert [file.name for file in tmp_path.iterdir()] == ["b.jpg.png"]


def test_photographs_without_cameras_beside_others_are_listed(tmp_path: Path) -> None:
    for name in ("a.jpg", "b.jpg", "c.jpg"):
        photograph(tmp_path / name, (64, 48))
    save_cameras(tmp_path / "cameras.json", nr.Camera.look_at((0.0, 0.0, -3.0)), ["b.jpg"], (48, 64))
    cameras = read_camera_file(tmp_path / "cameras.json")
    assert photographs_beside(tmp_path, cameras) == ["a.jpg", "c.jpg"]
    assert photographs_beside(tmp_path / "cameras.json", cameras) == []


@pytest.mark.parametrize("draws", [True, False])
@pytest.mark.parametrize("hides", [0, 1])
def test_masks_of_no_closed_object_are_a_draft(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], draws: bool, hides: int
) -> None:
    pytest.importorskip("pycolmap")
    cameras, true = scene(tmp_path)
    out, place = tmp_path / "out", "neural_renderer.apps.fit.commands.cameras"

    def find(cameras: CameraFile, folder: Path, *_: object) -> object_masks.FoundMasks:
        for number, mask in enumerate(true[hides:] if draws else []):
            nr.save_image(folder / "masks" / f"{number + hides}.png.png", mask)
        return object_masks.FoundMasks("the reason", 0.0, True, torch.zeros(0, 3))

    motion = SimpleNamespace(placed=[entry.name for entry in cameras.images], points=500, model=out, missing={})
    motion.is_exact, motion.is_whole, motion.agreement, motion.apart = True, True, Agreement(9, 10), 0.0
    motion.is_smoothed = False
    monkeypatch.setattr(f"{place}.find_cameras", lambda *_: motion)
    monkeypatch.setattr(f"{place}.read_camera_file", lambda _: cameras)
    monkeypatch.setattr(f"{place}.find_masks", find)
    command = ["fit", str(tmp_path / "images"), "-o", str(out), "--cameras", "sfm", "--masks-only"]
    assert cli.main(command) == (0 if draws else 1)
    said = " ".join("".join(capsys.readouterr()).split())
    assert "the reason. For an object, take photographs from all around it" in said
    drafts = [f"{number}.png.png" for number in range(hides, 8)] if draws else []
    assert sorted(file.name for file in out.glob("masks/draft/*")) == drafts
    assert not list(out.glob("masks/*.png")), "the next call would take them for masks"
    assert (out / "masks.jpg").is_file() == draws
    if draws:
        monkeypatch.setattr(
            f"{place}.find_masks", lambda *_: object_masks.FoundMasks(None, 0.0, True, torch.zeros(0, 3))
        )
        assert cli.main([*command, "--masks", str(out / "masks" / "draft")]) == 0
        assert f"masks: {8 - hides} from files" in " ".join("".join(capsys.readouterr()).split())


def test_masks_that_are_known_are_written_with_the_size_of_the_copies(tmp_path: Path) -> None:
    disc = nr.render(nr.Mesh.icosphere(2), nr.Camera.look_at((0.0, 0.0, -2.7)), 64).alpha
    for name in ("a", "b"):
        nr.save_image(tmp_path / f"{name}.png", torch.cat((disc.expand(3, -1, -1) * 0.5, disc)))
    copies = copy_photographs(tmp_path, tmp_path / "out", 60, quiet)
    assert write_known_masks(copies, [], MaskRule(), quiet) == {"transparency": 2}
    np.testing.assert_allclose(nr.load_image(tmp_path / "out" / "masks" / "a.png.png")[..., 0], disc[0], atol=STEP)
    photograph(tmp_path / "many" / "a.jpg", (64, 48))
    assert not write_known_masks(
        copy_photographs(tmp_path / "many", tmp_path / "none", 60, quiet), [], MaskRule(), quiet
    )


@pytest.mark.parametrize("pattern, is_plain", [(0.0, True), (0.02, True), (0.08, False)])
def test_only_a_background_without_a_pattern_is_plain(tmp_path: Path, pattern: float, is_plain: bool) -> None:
    rng = torch.Generator().manual_seed(0)
    disc = nr.render(nr.Mesh.icosphere(2), nr.Camera.look_at((0.0, 0.0, -4.0)), 192).alpha[0]
    light = torch.linspace(0.4, 0.6, 192)[:, None].expand(3, 192, 192)
    for name in ("a", "b", "c"):
        patches = torch.randn(3, 12, 12, generator=rng).repeat_interleave(16, 1).repeat_interleave(16, 2)
        texture = torch.randn(3, 192, 192, generator=rng) if is_plain else patches
        image = torch.lerp(light + pattern * texture, torch.tensor([0.95, 0.1, 0.1])[:, None, None], disc)
        nr.save_image(tmp_path / f"{name}.png", image.clamp(0, 1))
    copies = copy_photographs(tmp_path, tmp_path / "out", 60, quiet)
    expected = {"a plain background": 3} if is_plain else {}
    assert write_known_masks(copies, [], MaskRule(), quiet) == expected
    assert len(list((tmp_path / "out" / "masks").glob("*.png"))) == len(expected) * 3
    colour = MaskRule(background=(0.5, 0.5, 0.5), tolerance=0.4)
    assert write_known_masks(copies, [], colour, quiet) == {"the options for masks": 3}


@pytest.mark.parametrize("darkening, is_plain", [(0.3, True), (0.9, False)])
def test_a_background_much_darker_at_the_corners_is_not_plain(tmp_path: Path, darkening: float, is_plain: bool) -> None:
    across = torch.linspace(-1, 1, 128)
    light = 1 - darkening * ((across**2 + across[:, None] ** 2) / 2) ** (1 if is_plain else 2)
    image = (0.7 * light).repeat(3, 1, 1)
    image[:, 48:80, 48:80] = torch.tensor([0.6, 0.2, 0.1])[:, None, None]
    nr.save_image(tmp_path / "a.png", image)
    copies = copy_photographs(tmp_path, tmp_path / "out", 60, quiet)
    assert bool(write_known_masks(copies, [], MaskRule(), quiet)) == is_plain


@pytest.mark.parametrize("holes, is_compact", [(0, True), (20, False)])
def test_a_background_with_colours_of_the_object_is_not_plain(tmp_path: Path, holes: int, is_compact: bool) -> None:
    image = torch.full((3, 192, 192), 0.5)
    image[:, 48:144, 48:144] = 0.9
    for number in range(holes):
        row, column = 52 + number // 5 * 20, 52 + number % 5 * 18
        image[:, row : row + 8, column : column + 8] = 0.5
    nr.save_image(tmp_path / "a.png", image)
    copies = copy_photographs(tmp_path, tmp_path / "out", 60, quiet)
    assert bool(write_known_masks(copies, [], MaskRule(), quiet)) == is_compact


def test_two_photographs_are_too_few(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pycolmap")
    photograph(tmp_path / "a.jpg", (64, 48))
    photograph(tmp_path / "b.jpg", (64, 48))
    photograph(tmp_path / "c.jpg", (1, 1))
    assert cli.main(["fit", str(tmp_path), "-o", str(tmp_path / "out")]) == 1
    said = capsys.readouterr().err
    assert "expected at least 3 photographs" in said
    assert said.splitlines()[1] == "  c.jpg: expected at least 16 pixels a side, got 1"


@pytest.mark.parametrize("phase", ["copy_photographs", "find_cameras"])
def test_interruption_says_that_the_same_command_continues(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, phase: str
) -> None:
    pytest.importorskip("pycolmap")

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    photograph(tmp_path / "a.jpg", (64, 48))
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "checkpoint.pt").write_bytes(b"of an earlier run")
    monkeypatch.setattr(f"neural_renderer.apps.fit.commands.cameras.{phase}", interrupted)
    assert cli.main(["fit", str(tmp_path), "-o", str(tmp_path / "out"), "--force"]) == 130
    assert capsys.readouterr().err == "interrupted: the same command continues\n"


def test_photographs_that_do_not_match_are_named_with_the_reason(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    rng = np.random.default_rng(0)
    for number in range(4):
        noise = np.kron(rng.integers(0, 255, (24, 32, 3), np.uint8), np.ones((4, 4, 1), np.uint8))
        noise = np.full_like(noise, 128) if number == 3 else noise
        Image.fromarray(noise).save(tmp_path / f"{number}.png")
    with pytest.raises(ValueError, match="placed 0 of 4") as error:
        find_cameras(copy_photographs(tmp_path, tmp_path / "out", 60, quiet), quiet)
    alike, plain = str(error.value).splitlines()[1:]
    assert alike.startswith("  0.png, 1.png, 2.png: matches no other photograph; it shows something else")
    assert plain.startswith("  3.png: ")
    assert "features" in plain or "blurred" in plain


def test_equal_photographs_are_said_to_show_the_same(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    pixels = np.kron(np.random.default_rng(0).integers(0, 255, (24, 32, 3), np.uint8), np.ones((4, 4, 1), np.uint8))
    for number in range(3):
        Image.fromarray(pixels).save(tmp_path / f"{number} .png")
    with pytest.raises(ValueError, match=r"\n  0_.png, 1_.png: sees what 2_.png sees from the same place"):
        find_cameras(copy_photographs(tmp_path, tmp_path / "out", 60, quiet), quiet)


@pytest.mark.parametrize("is_whole", [False, True])
def test_masks_restrict_features_where_there_are_masks(tmp_path: Path, is_whole: bool) -> None:
    colmap = pytest.importorskip("pycolmap")
    for name in ("a.png", "b.png"):
        noise = np.random.default_rng(0).integers(0, 255, (24, 32, 3), np.uint8)
        (tmp_path / "images").mkdir(exist_ok=True)
        Image.fromarray(np.kron(noise, np.ones((5, 5, 1), np.uint8))).save(tmp_path / "images" / name)
    mask = torch.zeros(120, 160)
    mask[30:90, 40:120] = 1
    nr.save_image(tmp_path / "masks" / "a.png.png", mask)
    _find_features(colmap, tmp_path, ["a.png", "b.png"], is_whole, quiet)
    with colmap.Database.open(tmp_path / "database.db") as database:
        images = [database.read_image_with_name(name) for name in ("a.png", "b.png")]
        masked, whole = (database.read_keypoints(image.image_id)[:, :2] for image in images)
    assert images[0].camera_id == images[1].camera_id
    inside = inside_mask(tmp_path, "a.png", whole)
    assert 0 < inside.sum() < len(whole)
    assert len(masked) == (len(whole) if is_whole else inside.sum())
    assert inside_mask(tmp_path, "b.png", whole).all(), "a photograph without a mask is used as a whole"


def moved(points: np.ndarray, degrees: float) -> np.ndarray:
    """Turn points [N, 3] around the axis of y."""
    angle = np.radians(degrees)
    return points @ np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])


@pytest.mark.parametrize(
    "object_turns, rest_turns, camera_turns, expected",
    [
        (12, 12, 0, (2, True)),  # the camera goes around an object that stands still
        (12, 0, 0, (2, False)),  # a turntable before a still camera
        (12, 0, 4, (2, False)),  # before one that is held in hands
        (-20, 12, 0, (2, False)),  # both move
        (None, 12, 0, (1, True)),  # the object has no features
        (None, 0, 4, (1, False)),
        (12, None, 0, (2, False)),  # the background has none
        (None, None, 0, (0, False)),
    ],
)
def test_matches_tell_whether_an_object_stands_still_in_its_surroundings(
    object_turns: float | None, rest_turns: float | None, camera_turns: float, expected: tuple[int, bool]
) -> None:
    colmap = pytest.importorskip("pycolmap")
    rng = np.random.default_rng(0)
    near, far = rng.uniform(-0.5, 0.5, (30, 3)), rng.uniform(-2, 2, (200, 3))
    far[:, 1] = rng.uniform(0.5, 1.0, 200)
    lens = colmap.Camera.create_from_model_name(1, "SIMPLE_PINHOLE", 500.0, 640, 480)

    def seen(points: np.ndarray, turn: float) -> np.ndarray:
        tilt = np.array([[1, 0, 0], [0, np.cos(0.4), -np.sin(0.4)], [0, np.sin(0.4), np.cos(0.4)]])
        inside = moved(points @ tilt.T + [0, 0, 5], turn)
        return inside[:, :2] / inside[:, 2:] * 500 + [320, 240] + rng.normal(0, 0.2, (len(points), 2))

    parts = [(points, turn) for points, turn in ((near, object_turns), (far, rest_turns)) if turn is not None]
    places = [np.zeros((0, 2)), np.zeros((0, 2))]
    if parts:
        places[0] = np.concatenate([seen(points, 0) for points, _ in parts])
        places[1] = np.concatenate([seen(moved(points, turn), camera_turns) for points, turn in parts])
    own = np.concatenate([np.full(len(points), points is near) for points, _ in parts] or [np.zeros(0, bool)])
    assert _moves_as_one(colmap, (lens, lens), (places[0], places[1]), (own, ~own)) == expected


def test_a_camera_that_turns_on_the_spot_is_told(tmp_path: Path) -> None:
    colmap = pytest.importorskip("pycolmap")
    rng = np.random.default_rng(0)
    around = np.zeros((300, 1500, 3))
    for side in (5, 12, 30, 75):
        noise = rng.uniform(0, 60, (300 // side + 1, 1500 // side + 1, 3))
        around += np.kron(noise, np.ones((side, side, 1)))[:300, :1500]
    rows, columns = np.mgrid[0:240, 0:320]
    across, down = (columns - 160) / 384, (rows - 120) / 384  # the focal length that is taken without EXIF data
    for number in range(5):
        angle = np.arctan(across) + np.radians(number * 5)
        u, v = 300 + angle * 600, 150 + down / np.sqrt(1 + across**2) * 450
        Image.fromarray(around[v.astype(int), u.astype(int)].clip(0, 255).astype(np.uint8)).save(
            tmp_path / f"{number}.png"
        )
    with pytest.raises(ValueError, match="the camera turned on the spot"):
        find_cameras(copy_photographs(tmp_path, tmp_path / "out", 60, quiet), quiet)
    with colmap.Database.open(tmp_path / "out" / "database.db") as database:
        assert only_turned(colmap, database), "told before anything is mapped"


def test_copies_have_names_of_their_own_without_spaces(tmp_path: Path) -> None:
    for name in ("#1 a.jpg", "Y.JPG", "x.jpeg", "x.jpg", "y.jpg"):
        photograph(tmp_path / name, (64, 48))
    nr.save_image(tmp_path / "m" / "x.jpeg.png", torch.zeros(48, 64))
    copies = copy_photographs(tmp_path, tmp_path / "out", 60, quiet)
    assert copies.names == ["Y_2.jpg", "_1_a.jpg", "x.jpg", "x_2.jpg", "y.jpg"]
    assert copies.find_mask(tmp_path / "m", "x_2.jpg") == tmp_path / "m" / "x.jpeg.png"
    assert copies.find_mask(tmp_path / "m", "x.jpg") is None


def test_photographs_that_differ_by_their_suffix_have_masks_of_their_own(tmp_path: Path) -> None:
    for name in ("x.jpg", "x.png"):
        photograph(tmp_path / name, (64, 48))
    for number, name in enumerate(("x.jpg", "x.png")):
        nr.save_image(tmp_path / "m" / name, torch.full((48, 64), float(number)))
    copies = copy_photographs(tmp_path, tmp_path / "out", 60, quiet)
    for copy, source in copies.sources.items():
        assert copies.find_mask(tmp_path / "m", copy) == tmp_path / "m" / source


def test_masks_of_photographs_that_stay_are_kept_and_those_asked_for_replace_them(tmp_path: Path) -> None:
    masks, hand = tmp_path / "out" / "masks", torch.zeros(48, 64)
    hand[10:20] = 1
    for name in ("a b.jpg", "c.jpg", "d.jpg"):
        photograph(tmp_path / name, (64, 48))
    copy_photographs(tmp_path, tmp_path / "out", 60, quiet)
    for name in ("a_b", "c", "d"):
        nr.save_image(masks / f"{name}.jpg.png", hand)
    kept = (masks / "a_b.jpg.png").read_bytes()
    (tmp_path / "a b.jpg").touch()
    photograph(tmp_path / "c.jpg", (32, 24))
    (tmp_path / "d.jpg").unlink()
    copies = copy_photographs(tmp_path, tmp_path / "out", 60, quiet)
    assert sorted(file.name for file in masks.glob("*.png")) == ["a_b.jpg.png"]
    assert sorted(file.name for file in (masks / "earlier").iterdir()) == ["c.jpg.png", "d.jpg.png"]
    write_known_masks(copies, [masks], MaskRule(), quiet)
    with Image.open(masks / "a_b.jpg.png") as scaled:
        assert scaled.size == (32, 24), "as large as the copies, which are smaller now"
    assert (masks / "a_b.jpg.png").read_bytes() != kept
    nr.save_image(tmp_path / "m" / "a b.png", 1 - hand)
    write_known_masks(copies, [tmp_path / "m", masks], MaskRule(), quiet)
    assert nr.load_image(masks / "a_b.jpg.png")[0, 0, 0] == 1
    assert nr.load_image(masks / "a_b.jpg.png")[7, 0, 0] == 0


def test_masks_that_are_not_there_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pycolmap")
    photograph(tmp_path / "a.jpg", (64, 48))
    (tmp_path / "none").mkdir()
    assert cli.main(["fit", str(tmp_path), "-o", str(tmp_path / "out"), "--masks", str(tmp_path / "none")]) == 1
    assert "--masks: expected masks named like the photographs" in " ".join(capsys.readouterr().err.split())
    assert cli.main(["fit", str(tmp_path), "-o", str(tmp_path / "out"), "--surface", "--masks-only"]) == 1
    assert "which has no masks" in " ".join(capsys.readouterr().err.split())


def synthetic(colmap: Any, file: Path, photographs: int, points: int) -> Any:
    """Make a model of photographs by one camera, and its database."""
    options = colmap.SyntheticDatasetOptions()
    options.num_rigs = options.num_cameras_per_rig = 1
    options.num_frames_per_rig, options.num_points3D = photographs, points
    colmap.set_random_seed(0)
    with colmap.Database.open(file) as database:
        return colmap.synthesize_dataset(options, database)


def test_pieces_are_joined_by_a_photograph_that_both_have(tmp_path: Path) -> None:
    colmap = pytest.importorskip("pycolmap")
    whole = synthetic(colmap, tmp_path / "database.db", 9, 200)
    (tmp_path / "images").mkdir()
    numbers = sorted(whole.reg_image_ids())
    first, second = (colmap.Reconstruction(whole) for _ in range(2))
    for piece, gone in ((first, numbers[5:]), (second, numbers[:4])):
        for number in gone:
            piece.deregister_frame(piece.image(number).frame_id)
    second.transform(colmap.Sim3d(1.1, colmap.Rotation3d([0.0, 0.6, 0.0, 0.8]), [0.1, -0.2, 0.3]))
    joined = join_pieces(colmap, [first, second], tmp_path, tmp_path / "database.db", mapping_options(colmap))
    assert joined.num_reg_images() == 9
    assert joined.compute_mean_reprojection_error() < 0.1


def test_photographs_with_the_place_of_another_are_named_if_they_show_something_else(tmp_path: Path) -> None:
    pictures = [torch.rand(3, 48, 64, generator=torch.Generator().manual_seed(seed)) for seed in (0, 1, 2, 1, 2)]
    files = [tmp_path / f"{number}.png" for number in range(5)]
    for file, picture in zip(files, pictures, strict=True):
        nr.save_image(file, picture)
    eyes = nr.get_points_from_angles(3.0, 20.0, torch.tensor([0.0, 90.0, 180.0, 90.0, 0.0]))
    assert displaced(nr.Camera.look_at(eyes, viewing_angle=20.0), files) == ["0.png", "4.png"]
    around = nr.get_points_from_angles(3.0, 20.0, torch.arange(5) * 72.0)
    assert displaced(nr.Camera.look_at(around, viewing_angle=20.0), files) == []


def test_matching_opens_its_database_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Opening writes, and COLMAP aborts the process where two write at once: progress is read by one connection."""
    monkeypatch.setattr(motion, "_POLL", 0.01)
    monkeypatch.setattr(motion, "only_turned", lambda *_: False)
    events: list[str] = []
    enough = threading.Event()

    @contextmanager
    def opened(_: Path) -> Iterator[SimpleNamespace]:
        events.append("opened")
        yield SimpleNamespace(num_keypoints=lambda: 0, num_matched_image_pairs=read)
        events.append("closed")

    def read() -> int:
        events.append("read")
        if events.count("read") > 2:
            enough.set()
        return 2

    def match(*_: object, **__: object) -> None:
        events.append("matching")
        enough.wait(60)

    options = SimpleNamespace(ransac=SimpleNamespace())
    made = dict.fromkeys(
        ("FeatureMatchingOptions", "TwoViewGeometryOptions", "ImportedPairingOptions"), lambda: options
    )
    token = SimpleNamespace(cancel=lambda: None)
    database = SimpleNamespace(open=opened)
    colmap = SimpleNamespace(**made, CancellationToken=lambda: token, Database=database, match_image_pairs=match)
    seen: list[int] = []
    motion._match(colmap, tmp_path / "database.db", ["a", "b", "c"], lambda phase, done, total: seen.append(done))
    assert events[:2] == ["opened", "matching"] and events[-1] == "closed" and events.count("opened") == 1
    assert seen[-1] == 3 and set(seen) == {2, 3}


@pytest.mark.parametrize("kept, best, doubt", [(400, 400, 0.0), (210, 210, 0.5), (190, 200, 0.5), (100, 200, 0.0)])
def test_focal_lengths_are_kept_at_first_if_that_explains_more(
    kept: int, best: int, doubt: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(motion, "agreement", lambda *_: Agreement(9, 10))
    monkeypatch.setattr(motion, "initial_pairs", lambda *_: [(1, 2)])
    monkeypatch.setattr(motion, "apart", lambda *_: 0.5)
    monkeypatch.setattr(motion, "_refined", lambda _, model: model)
    refined = []

    def mapped(*arguments: Any, **_: Any) -> dict[int, Any]:
        refined.append(arguments[3].ba_refine_focal_length)
        count = 200 if refined[-1] else kept
        return {0: SimpleNamespace(num_reg_images=lambda: 3, compute_num_observations=lambda: count)}

    colmap = SimpleNamespace(
        IncrementalPipelineOptions=lambda: SimpleNamespace(mapper=SimpleNamespace()),
        incremental_mapping=mapped,
    )
    found, away = motion._map_matched(colmap, tmp_path, tmp_path / "database.db", 3, quiet)
    assert refined == [False, True]
    assert found.compute_num_observations() == best and away == doubt  # only where both explain as much


def test_mapping_begins_anew_where_matches_contradict_the_cameras(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shares = iter([3, 4, 2, 9, 8])
    starts: list[tuple[int, int] | None] = []
    monkeypatch.setattr(motion, "agreement", lambda *_: Agreement(next(shares), 10))
    monkeypatch.setattr(motion, "initial_pairs", lambda *_: [(1, 2), (3, 4), (5, 6)])

    def mapped(*arguments: Any, **_: Any) -> dict[int, Any]:
        options = arguments[3]
        starts.append((options.init_image_id1, options.init_image_id2) if hasattr(options, "init_image_id1") else None)
        count = 100 * len(starts)
        return {0: SimpleNamespace(num_reg_images=lambda: 3, compute_num_observations=lambda: count)}

    colmap = SimpleNamespace(
        IncrementalPipelineOptions=lambda: SimpleNamespace(mapper=SimpleNamespace()),
        incremental_mapping=mapped,
    )
    found, away = motion._map_matched(colmap, tmp_path, tmp_path / "database.db", 3, quiet)
    assert starts == [None, None, (1, 2), (3, 4)]
    assert found.compute_num_observations() == 400 and away == 0.0


@pytest.mark.parametrize("distance, placed, tried", [(0.05, 3, 2), (0.2, 3, 4), (0.05, 4, 3)])
def test_mapping_begins_no_more_where_other_pairs_lead_to_the_same_cameras(
    distance: float, placed: int, tried: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two more ways in a row suffice, unless one of them places another photograph: here the first pair's does."""
    starts = []
    monkeypatch.setattr(motion, "agreement", lambda *_: Agreement(6, 10))
    monkeypatch.setattr(motion, "initial_pairs", lambda *_: [(1, 2), (3, 4), (5, 6), (7, 8)])
    monkeypatch.setattr(motion, "apart", lambda *_: distance)
    monkeypatch.setattr(motion, "poses_of", lambda model: model.poses)
    monkeypatch.setattr(motion, "_refined", lambda _, model: model)

    def mapped(*arguments: Any, **_: Any) -> dict[int, Any]:
        starts.append(hasattr(arguments[3], "init_image_id1"))
        poses = dict.fromkeys(range(placed if len(starts) == 3 else 3))
        return {0: SimpleNamespace(num_reg_images=lambda: 3, compute_num_observations=lambda: 100, poses=poses)}

    colmap = SimpleNamespace(
        IncrementalPipelineOptions=lambda: SimpleNamespace(mapper=SimpleNamespace()),
        incremental_mapping=mapped,
    )
    assert motion._map_matched(colmap, tmp_path, tmp_path / "database.db", 4, quiet)[1] == distance
    assert starts == [False, False, *[True] * tried]


@pytest.mark.parametrize(
    "points, is_around, flat, kept",
    [(900, True, 5, 900), (400, True, 5, 500), (900, False, 5, 500), (900, True, 0, 500)],
)
def test_an_object_that_was_turned_is_told_from_its_background(
    points: int, is_around: bool, flat: int, kept: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Matches of the background move as those of a turn of the camera, and all cameras are on one side of it."""
    database, counts = tmp_path / "database.db", iter([500, points])
    database.write_bytes(b"all")
    monkeypatch.setattr(motion, "_match", lambda *_: None)
    monkeypatch.setattr(motion, "_is_one_sided", lambda model: model.count == 500 or not is_around)

    def drop(_: object, file: Path) -> int:
        file.write_bytes(b"some")
        return flat

    def mapped(_: object, __: Path, file: Path, *___: object) -> tuple[Any, float]:
        count = next(counts)
        assert file.read_bytes() == (b"all" if count == 500 else b"some")
        return SimpleNamespace(count=count, compute_num_observations=lambda: count), count / 1000

    monkeypatch.setattr(motion, "drop_flat", drop)
    monkeypatch.setattr(motion, "_map_matched", mapped)
    model, away = motion._map(None, tmp_path, ["a", "b"], quiet)
    assert model.count == kept and away == kept / 1000
    assert database.read_bytes() == (b"some" if kept == 900 else b"all")


@pytest.mark.parametrize("placed, again, kept", [(5, 9, 5), (4, 9, 9), (4, 2, 4), (0, 6, 6), (4, None, 4), (4, -1, 4)])
def test_photographs_are_smoothed_where_fewer_than_half_are_placed(
    placed: int, again: int | None, kept: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (24, 32, 3), np.uint8)
    nr.save_image(tmp_path / "masks/0.png.png", torch.ones(24, 32))
    (tmp_path / "images").mkdir()
    for number in range(10):
        Image.fromarray(noise).save(tmp_path / f"images/{number}.png")
    found = motion.Photographs(tmp_path, {f"{number}.png": 1.0 for number in range(10)})
    left: list[float] = []

    def place(_: object, photographs: motion.Photographs, __: object) -> tuple[Any, float]:
        (photographs.folder / "database.db").write_bytes(b"smooth" if left else b"first")
        assert (photographs.folder / "masks/0.png.png").is_file()
        left.append(float(nr.io.load_image(photographs.folder / "images/3.png").std()))
        count = again if len(left) > 1 else placed
        if count is None:
            raise ValueError(motion._NO_DEPTH)
        made = {"num_reg_images": count, "compute_num_observations": 100 * count, "num_points3D": 50}
        return SimpleNamespace(
            **{name: (lambda value=value: value) for name, value in made.items()}
        ) if count > 0 else None, 0.0

    monkeypatch.setattr(motion, "_place", place)
    monkeypatch.setattr(motion, "_refine", lambda *_: None)
    monkeypatch.setattr(motion, "agreement", lambda _, __, model: Agreement(model.num_reg_images(), 10))
    best, _, is_smoothed = motion._reconstruct(None, found, quiet)
    assert is_smoothed == (kept == again)
    assert best.num_reg_images() == kept
    assert (tmp_path / "database.db").read_bytes() == (b"smooth" if kept == again else b"first")
    assert len(left) == (1 if placed == 5 else 2)
    assert len(left) == 1 or left[1] < 0.4 * left[0], "noise is smoothed"


def test_matched_pairs_agree_with_right_cameras_only(tmp_path: Path) -> None:
    colmap = pytest.importorskip("pycolmap")
    file = tmp_path / "database.db"
    right = synthetic(colmap, file, 8, 120)
    pairs_of_all = pairs.agreement(colmap, file, right)
    assert pairs_of_all == Agreement(28, 28) and pairs_of_all.is_good
    wrong = colmap.Reconstruction(right)
    first, second = sorted(wrong.reg_frame_ids())[:2]
    poses = [colmap.Rigid3d(wrong.frame(number).rig_from_world.matrix()) for number in (first, second)]
    wrong.frame(first).rig_from_world, wrong.frame(second).rig_from_world = poses[1], poses[0]
    assert pairs.agreement(colmap, file, wrong).agreeing <= 28 - 12 and not pairs.agreement(colmap, file, wrong).is_good
    moved = colmap.Reconstruction(right)
    moved.transform(colmap.Sim3d(2.0, colmap.Rotation3d([0.0, 0.6, 0.0, 0.8]), [0.1, -0.2, 0.3]))
    assert pairs.apart(right, moved) < 1e-6
    short = colmap.Reconstruction(right)  # the usual focal length, kept, where the lens has twice as much
    for lens in short.cameras.values():
        lens.focal_length = lens.focal_length / 2
    kept = colmap.BundleAdjustmentOptions()
    kept.refine_focal_length = False
    motion.adjust(colmap, short, kept)
    assert pairs.apart(short, right) > 0.01
    assert pairs.apart(*(motion._refined(colmap, model) for model in (short, right))) < 0.01, "another lens is no doubt"
    kinds = colmap.TwoViewGeometryConfiguration
    with colmap.Database.open(file) as opened:
        flat = opened.read_two_view_geometries()[0][:3]
        for pair, kind in zip(flat, (kinds.PANORAMIC, kinds.PLANAR_OR_PANORAMIC, kinds.WATERMARK), strict=True):
            images = colmap.pair_id_to_image_pair(pair)
            geometry = opened.read_two_view_geometry(*images)
            geometry.config = kind
            opened.update_two_view_geometry(*images, geometry)
    assert pairs.drop_flat(colmap, file) == 3 and pairs.agreement(colmap, file, right) == Agreement(25, 25)
    assert pairs.drop_flat(colmap, file) == 0 and not motion._is_one_sided(right)
    starts = pairs.initial_pairs(colmap, file)
    assert len({number for pair in starts for number in pair}) == 8 == 2 * len(starts)
