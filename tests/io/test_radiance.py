"""Pictures of Radiance and OpenEXR, against OpenCV's and by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import neural_renderer as nr
from neural_renderer.io.image_formats.radiance import read_radiance

HEADER = b"#?RADIANCE\n# a comment\nFORMAT=32-bit_rle_rgbe\n"


def written(path: Path, body: bytes, header: bytes = HEADER) -> np.ndarray:
    path.write_bytes(header + b"\n" + body)
    return read_radiance(path)


@pytest.mark.parametrize("width", [7, 8, 300])
def test_it_is_what_opencv_reads(width: int, tmp_path: Path) -> None:
    """Runs and single bytes, of rows narrow (plain) and wide (coded by channel)."""
    cv2 = pytest.importorskip("cv2")
    light = np.random.default_rng(0).lognormal(0, 3, (20, width, 3)).astype(np.float32)
    light[5:9, : width // 2], light[12] = 0.25, 0.0
    cv2.imwrite(str(tmp_path / "a.hdr"), light)
    found = read_radiance(tmp_path / "a.hdr")
    np.testing.assert_array_equal(found, cv2.imread(str(tmp_path / "a.hdr"), cv2.IMREAD_UNCHANGED)[..., ::-1])
    # Eight bits of the largest channel.
    assert (np.abs(found - light[..., ::-1]) <= light.max(-1, keepdims=True) / 127).all()


def test_sizes_exposures_and_old_runs(tmp_path: Path) -> None:
    path = tmp_path / "a.hdr"
    red, grey = bytes([128, 0, 0, 129]), bytes([64, 64, 64, 128])
    expected = np.array([[[1, 0, 0], [1, 0, 0], [1, 0, 0], [0.25, 0.25, 0.25]]], np.float32)
    body = red + bytes([1, 1, 1, 2]) + grey
    np.testing.assert_array_equal(written(path, b"-Y 1 +X 4\n" + body), expected)
    np.testing.assert_array_equal(written(path, b"-Y 1 -X 4\n" + body), expected[:, ::-1])
    np.testing.assert_array_equal(written(path, b"+Y 2 +X 1\n" + red + grey)[:, 0], expected[0, [3, 0]])
    brighter = HEADER + b"EXPOSURE=2.0\nEXPOSURE=2.0\n"
    np.testing.assert_array_equal(written(path, b"-Y 1 +X 4\n" + body, brighter), expected / 4)
    row = red * 260  # 256 + 4 pixels: the second count is in the next byte
    coded = red + bytes([1, 1, 1, 3, 1, 1, 1, 1])
    np.testing.assert_array_equal(written(path, b"-Y 1 +X 260\n" + coded), written(path, b"-Y 1 +X 260\n" + row))


@pytest.mark.parametrize(
    ("body", "header", "message"),
    [
        (b"", b"P6\n", "expected a picture of Radiance, got a file of another format"),
        (b"", b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n", "expected RGB with an exponent"),
        (b"-Y two +X 4\n", HEADER, "expected a size such as -Y 512"),
        (b"+X 4 -Y 2\n", HEADER, "expected a size such as -Y 512"),
        (b"-Y 99999 +X 99999\n", HEADER, "expected a picture of at most"),
        (b"-Y 0 +X 4\n", HEADER, "expected a picture with pixels"),
        (b"-Y 1 +X 2\n\1\2\3\4\1\2", HEADER, "got a damaged one"),
        (b"-Y 1 +X 2\n\1\2\3\4\1\1\1\xff", HEADER, "got a damaged one"),
        (b"-Y 1 +X 8\n\2\2\0\x08\xff\1", HEADER, "got a damaged one"),
        (b"-Y 1 +X 8\n\2\2\0\x08\0\0", HEADER, "got a damaged one"),
        (b"-Y 1 +X 8\n\2\2", HEADER, "got a damaged one"),
        (b"-Y 1 +X 1\n\1\2\3\4", HEADER + b"EXPOSURE=no\n", "got a damaged one"),
    ],
)
def test_what_is_damaged(body: bytes, header: bytes, message: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=f"a.hdr: .*{message}"):
        written(tmp_path / "a.hdr", body, header)


def test_an_environment_of_each_format(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    exr = pytest.importorskip("OpenEXR")
    light = torch.rand(4, 8, 3) + 0.5
    channels = {name: np.ascontiguousarray(light[..., i].numpy()) for i, name in enumerate("RGB")}
    with exr.File({"type": exr.scanlineimage}, channels) as image:
        image.write(str(tmp_path / "a.exr"))
    assert torch.equal(nr.EnvironmentLight.load(tmp_path / "a.exr").image, light)
    (tmp_path / "b.exr").write_bytes(b"no")
    with pytest.raises(ValueError, match=r"b\.exr: expected a picture of OpenEXR"):
        nr.EnvironmentLight.load(tmp_path / "b.exr")
    with monkeypatch.context() as smaller:
        smaller.setattr(Image, "MAX_IMAGE_PIXELS", 31)
        with pytest.raises(ValueError, match=r"a\.exr: expected a picture of at most 31 pixels"):
            nr.EnvironmentLight.load(tmp_path / "a.exr")
    pixels = b"-Y 1 +X 2\n" + bytes([128, 0, 0, 131]) * 2
    written(tmp_path / "c.HDR", pixels)
    loaded = nr.EnvironmentLight.load(tmp_path / "c.HDR", 0.5)
    assert loaded.image[0, 0].tolist() == [4.0, 0.0, 0.0] and loaded.intensity == 0.5
    nr.save_image(tmp_path / "d.png", light.clamp(max=1))
    stored = nr.load_image(tmp_path / "d.png")
    torch.testing.assert_close(nr.EnvironmentLight.load(tmp_path / "d.png").image, nr.srgb_to_linear(stored))
    with pytest.raises(FileNotFoundError, match=r"e\.hdr"):
        nr.EnvironmentLight.load(tmp_path / "e.hdr")
