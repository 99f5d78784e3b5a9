"""Pictures and animations: shapes, kinds, and refused files."""

from __future__ import annotations

import shutil
import struct
import tracemalloc
import warnings
import zlib
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from neural_renderer.apps.common.pictures.animation import save_animation
from neural_renderer.io.formats import load_mesh
from neural_renderer.io.images import load_image, load_reduced, save_image
from neural_renderer.meshes.uv_mesh import UVMesh
from tests.rounding import relative


@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 1), (5, 7, 3), (5, 7, 4), (3, 5, 7), (4, 5, 7), (1, 5, 7)])
def test_save_and_load(tmp_path, shape):
    image = torch.randint(0, 256, shape) / 255
    save_image(tmp_path / "a/b/image.png", image.requires_grad_())
    loaded = load_image(tmp_path / "a/b/image.png")
    expected = image.movedim(0, 2) if shape[0] in (1, 3, 4) else image if image.ndim == 3 else image[..., None]
    if expected.shape[2] == 1:
        expected = expected.expand(5, 7, 3)
    assert loaded.dtype == torch.float32 and torch.allclose(loaded, expected, **relative(2))
    save_image(tmp_path / "image.jpg", image.detach().numpy())
    assert load_image(tmp_path / "image.jpg").shape == (5, 7, 3)


def test_clamped_and_on_white(tmp_path):
    save_image(tmp_path / "a.png", torch.tensor([[-1.0, 0.5, 2.0]]))
    assert (load_image(tmp_path / "a.png")[0, :, 0] * 255).round().tolist() == [0, 128, 255]
    save_image(tmp_path / "a.jpeg", torch.zeros(8, 8, 4))
    assert (load_image(tmp_path / "a.jpeg") > 0.98).all()
    save_image(tmp_path / "b.png", np.full((4, 4, 3), 51, np.uint8))
    assert torch.allclose(load_image(tmp_path / "b.png"), torch.full((4, 4, 3), 0.2), **relative(4))


def test_kinds(tmp_path):
    Image.fromarray(np.full((4, 5), 13107, np.uint16)).save(tmp_path / "deep.png")
    assert torch.allclose(load_image(tmp_path / "deep.png"), torch.full((4, 5, 3), 0.2), **relative(4))
    Image.new("LA", (5, 4), (51, 102)).save(tmp_path / "la.png")
    assert torch.allclose(load_image(tmp_path / "la.png")[0, 0], torch.tensor([0.2, 0.2, 0.2, 0.4]), **relative(4))
    Image.new("CMYK", (5, 4)).save(tmp_path / "cmyk.jpg")
    assert load_image(tmp_path / "cmyk.jpg").shape == (4, 5, 3)


@pytest.mark.parametrize("mode", ["1", "L", "P", "RGB", "RGBA", "CMYK", "I;16"])
def test_strips_show_the_whole_picture(mode, tmp_path, monkeypatch):
    if mode == "I;16":
        picture = Image.fromarray(np.arange(77 * 256, step=256, dtype=np.uint16).reshape(11, 7))
    else:
        picture = Image.fromarray(np.arange(11 * 7 * 3, dtype=np.uint8).reshape(11, 7, 3)).convert(mode)
    picture.save(tmp_path / "a.tif")
    whole = load_image(tmp_path / "a.tif")
    monkeypatch.setattr("neural_renderer.io.images._STRIP", 3 * 7)
    assert whole.shape[:2] == (11, 7) and whole[:8].unique().numel() > 1
    assert torch.equal(load_image(tmp_path / "a.tif"), whole)


def test_errors(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"absent\.png"):
        load_image(tmp_path / "absent.png")
    (tmp_path / "text.png").write_text("no picture")
    with pytest.raises(
        ValueError, match=r"text\.png: expected a picture, got a file of an unknown format, none of PNG"
    ):
        load_image(tmp_path / "text.png")
    with pytest.raises(ValueError, match=r"\.jpeg, \.hdr, \.exr, got 'a\.webp'"):
        save_image(tmp_path / "a.webp", torch.zeros(2, 2))
    with pytest.raises(ValueError, match="1 that are NaN"):
        save_image(tmp_path / "a.png", torch.tensor([[0.0, float("nan")]]))
    with pytest.raises(ValueError, match=r"got \[2, 3, 4, 4\]"):
        save_image(tmp_path / "a.png", torch.zeros(2, 3, 4, 4))
    with pytest.raises(TypeError, match="got list"):
        save_image(tmp_path / "a.png", [[0.0]])
    with pytest.raises(ValueError, match=r"\.gif, \.mp4, got 'a\.avi'"):
        save_animation(tmp_path / "a.avi", torch.zeros(2, 3, 8, 8))
    with pytest.raises(ValueError, match="frames: expected at least one"):
        save_animation(tmp_path / "a.gif", [])
    with pytest.raises(ValueError, match=r"frames\[1\]: expected 8 x 6 pixels like the first frame, got 8 x 5"):
        save_animation(tmp_path / "a.gif", [torch.zeros(6, 8), torch.zeros(5, 8, 3)])
    wide = np.zeros((1, 65536, 3), np.uint8)
    with pytest.raises(ValueError, match=r"image: expected at most 65500 pixels a side for 'a\.jpg', got 65536"):
        save_image(tmp_path / "a.jpg", wide)
    with pytest.raises(ValueError, match=r"frames: expected at most 65535 pixels a side for 'a\.gif', got 65536"):
        save_animation(tmp_path / "a.gif", [wide])
    with pytest.raises(ValueError, match="fps: expected a finite number above 0, got 0"):
        save_animation(tmp_path / "a.gif", torch.zeros(2, 3, 8, 8), fps=0)
    with pytest.raises(TypeError, match="fps: expected a number, got str"):
        save_animation(tmp_path / "a.gif", torch.zeros(2, 3, 8, 8), fps="a")
    with pytest.raises(TypeError, match="frames: expected pictures, got NoneType"):
        save_animation(tmp_path / "a.gif", None)
    with pytest.raises(ValueError, match="image: expected a tensor with numbers"):
        save_image(tmp_path / "a.png", torch.zeros(3, 8, 8, device="meta"))
    with pytest.raises(TypeError, match="image: expected a dense tensor"):
        save_image(tmp_path / "a.png", torch.ones(3, 8, 8).to_sparse())


def zeros_png(path: Path, width: int, height: int, rows: int) -> Path:
    """Make the smallest PNG of black pixels with more rows in its header than allowed."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    packed = zlib.compressobj(9)
    data = b"".join(packed.compress(bytes(1 + 3 * width)) for _ in range(rows)) + packed.flush()
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", data) + chunk(b"IEND", b""))
    return path


LARGE = r"bomb\.png: expected a picture of at most [\d,]+ pixels, got 10000 x 10000; .*PIL\.Image\.MAX_IMAGE_PIXELS"


@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
def test_a_picture_is_measured_before_it_is_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 89_478_485)  # Pillow's own
    path = zeros_png(tmp_path / "bomb.png", 10_000, 10_000, 1)
    load_image(zeros_png(tmp_path / "small.png", 4, 4, 1))  # imports what reads pictures
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=LARGE):
            load_image(path)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()
    (tmp_path / "m.mtl").write_text("newmtl m\nmap_Kd bomb.png\n")
    uv = "vt 0 0\nvt 1 0\nvt 0 1\n"
    (tmp_path / "m.obj").write_text(f"mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\n{uv}usemtl m\nf 1/1 2/2 3/3\n")
    for load in (load_mesh, UVMesh.load):
        with pytest.raises(ValueError, match=LARGE):
            load(tmp_path / "m.obj")
    picture = Image.open(path)
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.new("RGB", (64, 64)))
    visual = trimesh.visual.TextureVisuals(uv=[[0, 0], [1, 0], [0, 1]], material=material)
    mesh = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], visual=visual, process=False)
    mesh.export(tmp_path / "m.glb")
    picture.close()
    assert load_mesh(tmp_path / "m.glb")[2] is not None


def test_no_program_is_run_to_read_a_picture(tmp_path, monkeypatch):
    (tmp_path / "a.png").write_text("%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\nshowpage\n%%EOF\n")
    monkeypatch.setattr("subprocess.Popen", lambda *_, **__: pytest.fail("run"))
    with pytest.raises(ValueError, match=r"a\.png: expected a picture, got a file of an unknown format"):
        load_image(tmp_path / "a.png")


def test_the_limit_of_a_program_counts(tmp_path, monkeypatch):
    save_image(tmp_path / "a.png", torch.zeros(20, 30))
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 599)
    with (
        pytest.warns(Image.DecompressionBombWarning),
        pytest.raises(ValueError, match="at most 599 pixels, got 30 x 20"),
    ):
        load_image(tmp_path / "a.png")
    save_image(tmp_path / "b.png", torch.zeros(20, 30, 4))
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 799)
    with pytest.raises(ValueError, match="at most 599 pixels, got 30 x 20"):
        load_image(tmp_path / "b.png")
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 800)
    assert load_image(tmp_path / "b.png").shape == (20, 30, 4)
    for limit in (600, None):
        monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", limit)
        assert load_image(tmp_path / "a.png").shape == (20, 30, 3)


def moving_square(size: tuple[int, int]) -> torch.Tensor:
    frames = torch.zeros(6, 3, *size)
    for index, frame in enumerate(frames):
        frame[0, 4:12, 3 * index : 3 * index + 8] = 1
    return frames


def test_a_photo_of_a_turned_camera(tmp_path):
    photo = Image.new("RGB", (6, 4), "black")
    photo.putpixel((0, 0), (255, 255, 255))
    noted = Image.Exif()
    noted[0x0112] = 6  # to be turned to the right by a quarter
    photo.save(tmp_path / "photo.png", exif=noted)
    stored, upright = load_image(tmp_path / "photo.png"), load_image(tmp_path / "photo.png", upright=True)
    assert stored.shape == (4, 6, 3) and stored[0, 0].min() == 1
    assert upright.shape == (6, 4, 3) and upright[0, -1].min() == 1


def test_gif_has_no_bands_and_a_still_background(tmp_path):
    """Eight gradients share 256 colours: a band is wider than a tile, so the error of its mean would be as large."""
    ramp = torch.linspace(0.1, 0.9, 1024).expand(3, 8, 1024)
    color = torch.tensor([[1.0, 1, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [0, 1, 1], [1, 0, 1], [1, 0.5, 0]])
    bands = torch.cat([ramp * c[:, None, None] for c in color], 1)
    frames = [torch.cat((torch.ones(3, 32, 1024), bands.roll(8 * shift, 1)), 1) for shift in range(3)]
    save_animation(tmp_path / "a.gif", frames)
    with Image.open(tmp_path / "a.gif") as gif:
        for index, frame in enumerate(frames):
            gif.seek(index)
            picture = torch.from_numpy(np.array(gif.convert("RGB"))).movedim(2, 0) / 255
            assert torch.equal(picture[:, :32], torch.ones(3, 32, 1024))
            error = (picture - frame)[:, 32:]
            assert torch.nn.functional.avg_pool2d(error[None], 8).abs().mean() < 0.5 * error.abs().mean() < 0.02


def test_gif(tmp_path):
    frames = moving_square((24, 33))
    save_animation(tmp_path / "new/a.gif", frames, fps=10)
    with Image.open(tmp_path / "new/a.gif") as gif:
        assert (gif.n_frames, gif.size, gif.info["loop"], gif.info["duration"]) == (6, (33, 24), 0, 100)
        for index, frame in enumerate(frames):
            gif.seek(index)
            assert np.abs(np.asarray(gif.convert("RGB")) / 255 - frame.movedim(0, 2).numpy()).max() < 0.05


def test_mp4_of_odd_size(tmp_path):
    frames = moving_square((63, 49))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        save_animation(tmp_path / "new/a.mp4", (frame for frame in frames), fps=12)
    reader = imageio_ffmpeg.read_frames(tmp_path / "new/a.mp4")
    facts = next(reader)
    assert facts["fps"] == 12 and facts["pix_fmt"].startswith("yuv420p") and facts["size"] == (50, 64)
    video = np.stack([np.frombuffer(frame, np.uint8).reshape(64, 50, 3) for frame in reader]) / 255
    assert len(video) == 6
    assert np.abs(video[:, :63, :49] - frames.movedim(1, 3).numpy()).mean() < 0.03


@pytest.mark.parametrize("encoder", ["false", "true"])
def test_an_encoder_that_fails_or_writes_nothing(tmp_path, monkeypatch, encoder):
    save_animation(tmp_path / "a.mp4", moving_square((16, 16)))
    before = (tmp_path / "a.mp4").read_bytes()
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", shutil.which(encoder))
    with pytest.raises(OSError, match=r"a\.mp4: expected to write it, got: "):
        save_animation(tmp_path / "a.mp4", moving_square((16, 16)))
    assert (tmp_path / "a.mp4").read_bytes() == before and len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("mode", ["L", "RGB", "RGBA"])
def test_reduced_pictures_are_means_of_blocks(tmp_path, mode):
    """Pillow rounds colours to 1/255; with transparency their products with it, which then are rounded again."""
    shape = (32, 64) if mode == "L" else (32, 64, len(mode))
    pixels = np.random.default_rng(0).integers(0, 256, shape, np.uint8)
    Image.fromarray(pixels, mode).save(tmp_path / "a.png")
    full = load_image(tmp_path / "a.png")
    for least, divisor in ((None, 1), (64, 1), (33, 1), (32, 2), (17, 2), (16, 4), (8, 8), (1, 8)):
        reduced, size = load_reduced(tmp_path / "a.png", least=least)
        assert size == (32, 64) and reduced.shape == (32 // divisor, 64 // divisor, full.shape[2])
        alpha, expected = full[..., 3:] if mode == "RGBA" else torch.ones(32, 64, 1), full[..., :3]
        products, mean = means(alpha * expected, divisor), means(alpha, divisor)
        roundings = 1 if divisor == 1 or mode != "RGBA" else 3  # of the products, their means, and alpha
        own = reduced[..., 3:] if mode == "RGBA" else torch.ones_like(mean)
        assert (own - mean).abs().max() <= 0.51 / 255
        assert (own * reduced[..., :3] - products).abs().max() <= (0.51 * roundings + (roundings > 1)) / 255


def means(values: torch.Tensor, divisor: int) -> torch.Tensor:
    """Average blocks of values [H, W, C]."""
    return values.unfold(0, divisor, divisor).unfold(1, divisor, divisor).mean((3, 4))


@pytest.mark.parametrize("divisor", [2, 4, 8])
def test_reduced_jpegs_keep_colours_that_are_constant(tmp_path, divisor):
    """Blocks of 16 pixels of one colour have no frequency for the decoder to leave out."""
    colors = np.random.default_rng(0).integers(0, 256, (4, 6, 3), np.uint8)
    Image.fromarray(colors.repeat(16, 0).repeat(16, 1)).save(tmp_path / "a.jpg", quality=95)
    full = load_image(tmp_path / "a.jpg")
    reduced, size = load_reduced(tmp_path / "a.jpg", least=96 // divisor)
    assert size == (64, 96) and reduced.shape == (64 // divisor, 96 // divisor, 3)
    # Inside of the blocks: beside their borders full pictures blend the colours of neighbours.
    inside = reduced.unfold(0, 16 // divisor, 16 // divisor).unfold(1, 16 // divisor, 16 // divisor)
    centers = full[8::16, 8::16]
    assert (inside[..., -1, -1] - centers).abs().max() <= 2 / 255


def test_sides_that_cannot_be_divided_stay(tmp_path):
    for size, expected in (((30, 20), (10, 15)), ((28, 20), (5, 7)), ((15, 20), (20, 15)), ((31, 33), (33, 31))):
        Image.new("RGB", size).save(tmp_path / "a.png")
        image, full = load_reduced(tmp_path / "a.png", least=1)
        assert tuple(image.shape[:2]) == expected and full == size[::-1]


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_reduced_photos_of_a_turned_camera(tmp_path, suffix):
    picture = Image.new("L", (64, 32))
    picture.paste(255, (0, 0, 16, 16))
    exif = Image.Exif()
    exif[0x0112] = 6  # the top of the scene is to the right
    picture.save(tmp_path / f"a{suffix}", exif=exif)
    stored, size = load_reduced(tmp_path / f"a{suffix}", least=16)
    assert size == (32, 64) and stored.shape == (8, 16, 3) and stored[:4, :4].min() > 0.9 > 0.1 > stored[:, 4:].max()
    upright, size = load_reduced(tmp_path / f"a{suffix}", least=16, upright=True)
    assert size == (64, 32)
    assert torch.equal(upright, stored.rot90(-1))
