"""Pictures of strangers: which decoders they reach, and how much memory they take."""

from __future__ import annotations

import gzip
import io
import json
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import neural_renderer as nr
from neural_renderer.io.gltf.surfaces.materials import GltfMaterial
from neural_renderer.io.image_formats.exr import read_exr
from neural_renderer.io.image_formats.pictures import FORMATS, open_picture
from neural_renderer.io.image_formats.radiance import radiance_bytes
from tests.gltf.files import UV, File
from tests.memory import takes_at_most
from tests.mutations import glb

SIDE = 2000
PIXELS = SIDE * SIDE / 1e6  # millions
FLOATS = 12 * PIXELS  # MB of the result


def fits() -> bytes:
    """A picture of 4 × 4 pixels whose gzip data have a megabyte: 512 of them took 1.3 GB."""

    def card(key: str, value: str) -> bytes:
        return f"{key:<8}= {value:>20}".ljust(80).encode()

    head = b"".join([card("SIMPLE", "T"), card("BITPIX", "8"), card("NAXIS", "0"), b"END".ljust(80)]).ljust(2880)
    keys = {"BITPIX": "8", "NAXIS": "2", "NAXIS1": "8", "NAXIS2": "1", "ZIMAGE": "T", "ZBITPIX": "8", "ZNAXIS": "2"}
    keys |= {"ZNAXIS1": "4", "ZNAXIS2": "4", "PCOUNT": "0", "GCOUNT": "1", "TFIELDS": "1"}
    cards = [b"XTENSION= 'BINTABLE'".ljust(80), *(card(*pair) for pair in keys.items())]
    table = b"".join([*cards, b"ZCMPTYPE= 'GZIP_1  '".ljust(80), b"END".ljust(80)]).ljust(2880)
    return head + table + bytes(8) + gzip.compress(bytes(1 << 20))


OTHERS = {
    "FITS": fits(),
    "PSD": b"8BPS" + struct.pack(">H6xHIIHH", 1, 3, 4, 4, 8, 3) + bytes(12) + struct.pack(">H", 0) + bytes(48),
    "McIdas": b"\0\0\0\0\0\0\0\4" + bytes(248),
    "EPS": b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 4 4\n%%EndComments\nshowpage\n",
    "SGI": b"\x01\xda" + bytes([0, 1]) + struct.pack(">HHHH", 3, 4, 4, 3) + bytes(500) + bytes(48),
    "XBM": b"#define a_width 4\n#define a_height 4\nstatic char a_bits[] = {\n0,0,0,0 };\n",
    "SVG": b'<svg xmlns="http://www.w3.org/2000/svg"><image href="file:///etc/passwd"/></svg>',
}


@pytest.mark.parametrize("name", OTHERS)
def test_other_decoders_are_not_reached(name: str, tmp_path: Path) -> None:
    """Whatever the file is called."""
    (tmp_path / "a.png").write_bytes(OTHERS[name])
    with pytest.raises(ValueError, match=r"a.png: expected a picture, got a file of an unknown format, none of PNG, J"):
        nr.load_image(tmp_path / "a.png")


def test_avif_and_heif_have_ways_of_their_own(tmp_path: Path) -> None:
    """AVIF only glTF, and HEIF only folders of photographs, by its suffix; not even after its library was loaded."""
    for library, name in (("PIL._avif", "AVIF"), ("pillow_heif", "HEIF")):
        loaded = pytest.importorskip(library)
        if name == "HEIF":
            loaded.register_heif_opener()
        Image.new("RGB", (64, 64), (255, 0, 0)).save(tmp_path / "a.png", name)
        with pytest.raises(ValueError, match=r"a.png: expected a picture, got a file of an unknown format"):
            nr.load_image(tmp_path / "a.png")


@pytest.mark.parametrize("name", FORMATS)
def test_known_formats_are_read_by_any_name(name: str, tmp_path: Path) -> None:
    Image.new("RGB", (8, 8), (255, 0, 0)).save(tmp_path / "a.x", name)
    assert (nr.load_image(tmp_path / "a.x").mean((0, 1)) - torch.tensor([1.0, 0, 0])).abs().max() < 0.02


def test_every_picture_is_opened_by_one_function() -> None:
    """`open_picture`, which names the formats."""
    source = Path(nr.__file__).parent
    users = {path.name for path in source.rglob("*.py") if "Image.open(" in path.read_text(encoding="utf-8")}
    assert users == {Path(open_picture.__code__.co_filename).name}


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def test_a_palette_that_is_missing(tmp_path: Path) -> None:
    head = chunk(b"IHDR", struct.pack(">IIBBBBB", 1, 1, 8, 3, 0, 0, 0))
    (tmp_path / "p.png").write_bytes(b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(b"\0\0")))
    with pytest.raises(ValueError, match=r"p.png: expected a picture, got one that cannot be read$"):
        nr.load_image(tmp_path / "p.png")


def segment(marker: int, data: bytes) -> bytes:
    return bytes([0xFF, marker]) + struct.pack(">H", len(data) + 2) + data


def jpeg_of_scans(scans: int, comment: bytes = b"") -> bytes:
    """A grey progressive JPEG of 16 × 16 pixels: a scan for the means, others of 18 bytes that say "nothing new"."""
    head = b"\xff\xd8" + segment(0xFE, comment) + segment(0xDB, b"\0" + b"\1" * 64)
    head += segment(0xC2, struct.pack(">BHHB", 8, 16, 16, 1) + b"\1\x11\0")
    code = bytes([1]) + bytes(15)  # one symbol, of one bit: no difference, or the end of 4 to 7 blocks
    head += segment(0xC4, b"\0" + code + b"\0") + segment(0xC4, b"\x10" + code + b"\x20")
    first, other = segment(0xDA, b"\1\1\0\0\0\0") + b"\x0f", segment(0xDA, b"\1\1\0\1\x3f\0") + b"\x1f"
    return head + first + other * (scans - 1) + b"\xff\xd9"


def test_scans_of_a_jpeg_have_a_limit(tmp_path: Path) -> None:
    """Each decodes all pixels: 4,000 of 88 million pixels, 0.7 MB, took minutes. Bytes elsewhere do not count."""
    path = tmp_path / "a.jpg"
    for content in (jpeg_of_scans(100), jpeg_of_scans(3, b"\xff\xda" * 200), jpeg_of_scans(3) + b"\xff\xda" * 200):
        path.write_bytes(content)
        assert nr.load_image(path).shape == (16, 16, 3)
    path.write_bytes(jpeg_of_scans(101))
    with pytest.raises(ValueError, match=r"a.jpg: expected a picture, got one .*\(it has more than 100 scans\)$"):
        nr.load_image(path)
    Image.new("RGB", (40, 40), (200, 10, 10)).save(path, progressive=True)
    assert nr.load_image(path).shape == (40, 40, 3)


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif", "a.bmp"])
def test_memory_of_pictures(name: str, tmp_path: Path) -> None:
    """The result, which has 12 bytes for each pixel, 4 of the decoded picture, and a strip."""
    Image.new("RGB", (SIDE, SIDE), (200, 10, 10)).save(tmp_path / name)
    nr.load_image(tmp_path / name)
    with takes_at_most(FLOATS + 4 * PIXELS + 40):
        nr.load_image(tmp_path / name)


@pytest.mark.slow
def test_memory_of_surroundings(tmp_path: Path) -> None:
    """Radiance took 49 bytes for each pixel, and pictures of 8 bits 52."""
    Image.new("RGB", (SIDE, SIDE), (200, 10, 10)).save(tmp_path / "a.png")
    (tmp_path / "a.hdr").write_bytes(radiance_bytes(np.ones((SIDE, SIDE, 3), np.float32)))
    for name in ("a.png", "a.hdr"):
        with takes_at_most(FLOATS + 8 * PIXELS + 60):
            nr.EnvironmentLight.load(tmp_path / name)


def write_exr(path: Path, names: list[str], side: int) -> None:
    exr = pytest.importorskip("OpenEXR")
    plane = np.zeros((side, side), np.float32)
    head = {"type": exr.scanlineimage, "compression": exr.ZIP_COMPRESSION}
    exr.File(head, dict.fromkeys(names, plane)).write(str(path))


def test_only_colours_of_an_exr_are_decoded(tmp_path: Path) -> None:
    """Sixty channels of 810,000 pixels have 194 MB; 4000² of them took 4.3 GB, from a file of 3.9 MB."""
    write_exr(tmp_path / "a.exr", [*"RGB", *(f"x{number}" for number in range(57))], 900)
    read_exr(tmp_path / "a.exr")
    with takes_at_most(10 + 80):
        assert read_exr(tmp_path / "a.exr").shape == (900, 900, 3)


def test_blocks_of_an_exr_have_a_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A block is decoded with all its channels."""
    write_exr(tmp_path / "a.exr", list("RGB"), 300)
    monkeypatch.setattr("neural_renderer.io.image_formats.exr._MOST_BLOCK", 3 * 300 * 256 * 4 - 1)
    with pytest.raises(ValueError, match=r"a.exr: expected blocks of at most 0 MiB, got 3 channels of 300 x 300"):
        read_exr(tmp_path / "a.exr")


def test_headers_of_an_exr_have_a_limit(tmp_path: Path) -> None:
    """OpenEXR compares each name with all others: 300,000 of them, 8 MB, took minutes."""
    exr = pytest.importorskip("OpenEXR")
    path, plane = tmp_path / "a.exr", np.zeros((2, 2), np.float32)
    colors = dict.fromkeys("RGB", plane)
    many = {f"c{number}": plane for number in range(3000)}
    exr.File({"comment": "a" * 300_000}, colors | many).write(str(path))
    assert read_exr(path).shape == (2, 2, 3)
    exr.File([exr.Part({}, colors | many, "a"), exr.Part({}, many, "b")]).write(str(path))
    with pytest.raises(ValueError, match=r"a.exr: expected a header of at most 4,096 channels and attributes and 4"):
        read_exr(path)
    exr.File({f"a{number}": 1 for number in range(4200)}, colors).write(str(path))
    with pytest.raises(ValueError, match=r"a.exr: expected a header of at most 4,096"):
        read_exr(path)


def test_pictures_above_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All readers count the bytes of what they decode: three channels of this many pixels."""
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 16)
    Image.new("RGB", (4, 4)).save(tmp_path / "a.png")
    Image.new("RGBA", (4, 4)).save(tmp_path / "b.png")
    (tmp_path / "a.hdr").write_bytes(radiance_bytes(np.ones((4, 5, 3), np.float32)))
    assert nr.load_image(tmp_path / "a.png").shape == (4, 4, 3)
    with pytest.raises(ValueError, match=r"b.png: expected a picture of at most 12 pixels, got 4 x 4; a program may"):
        nr.load_image(tmp_path / "b.png")
    with pytest.raises(ValueError, match=r"a.hdr: expected a picture of at most 16 pixels, got 5 x 4; a program may"):
        nr.EnvironmentLight.load(tmp_path / "a.hdr")
    write_exr(tmp_path / "a.exr", list("RGB"), 5)
    with pytest.raises(ValueError, match=r"a.exr: expected a picture of at most 16 pixels, got 5 x 5; a program may"):
        nr.EnvironmentLight.load(tmp_path / "a.exr")


def test_pictures_of_a_model_have_a_limit_in_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A few large ones, or as many as their bytes explain: PNG packs 300 pixels of one shade into a byte."""
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 400 * 400)
    for number in range(9):
        Image.new("RGB", (400, 400), (number, 0, 0)).save(tmp_path / f"{number}.png")
    size = (tmp_path / "0.png").stat().st_size
    for count, fits in ((4, True), (9, False)):
        assert (count * 400 * 400 <= 4 * 400 * 400 + 64 * count * size) == fits
        texts = {
            "obj": "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n",
            "mtl": "",
        }
        for number in range(count):
            texts["obj"] += f"usemtl m{number}\nf 1/1 2/2 3/3\n"
            texts["mtl"] += f"newmtl m{number}\nmap_Kd {number}.png\n"
        for suffix, text in texts.items():
            (tmp_path / f"a.{suffix}").write_text(text)
        comments = "".join(f"comment TextureFile {number}.png\n" for number in range(count))
        corners = "property list uchar int vertex_indices\nproperty list uchar float texcoord\nproperty int texnumber\n"
        points = "element vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
        rows = "0 0 0\n1 0 0\n0 1 0\n3 0 1 2 6 0 0 1 0 0 1 0\n"
        (tmp_path / "a.ply").write_text(f"ply\nformat ascii 1.0\n{comments}{points}{corners}end_header\n{rows}")
        for name in ("a.obj", "a.ply"):
            if fits:
                assert nr.UVMesh.load(tmp_path / name).images
            else:
                with pytest.raises(ValueError, match=r"\.png: expected pictures of at most [\d,]+ pixels in all"):
                    nr.UVMesh.load(tmp_path / name)


@pytest.mark.parametrize("count", [1, 9])
def test_equal_pictures_of_gltf_are_decoded_once(count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Different ones of small files have a limit."""
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 400 * 400)
    file = File()
    coordinates = file.array(UV)
    primitives = []
    for number in range(9):
        content = io.BytesIO()
        Image.new("RGB", (400, 400), (number % count, 0, 0)).save(content, "PNG")
        file.add("images", {"bufferView": file.view(content.getvalue()), "mimeType": "image/png"})
        file.add("textures", {"source": number})
        material = {"pbrMetallicRoughness": {"baseColorTexture": {"index": number}}}
        primitives.append(file.square(material, TEXCOORD_0=coordinates))
    path = file.scene(*primitives).save(tmp_path / "m.glb")
    if count == 1:
        assert len(nr.UVMesh.load(path).images) == 1
    else:
        with pytest.raises(ValueError, match=r"m.glb: .*image 8: expected pictures of at most [\d,]+ pixels in all"):
            nr.UVMesh.load(path)


@pytest.mark.parametrize("is_old", [False, True])
def test_pictures_made_for_many_materials_count(is_old: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A tint, or a conversion, is a picture of its own: 400 of 8 million pixels took more than 5 GB."""
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 5000)
    corners = torch.tensor([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    geometry = torch.nn.functional.pad(corners, (0, 1)), torch.tensor([[0, 1, 2]]), corners
    nr.UVMesh(*geometry, torch.eye(50)[..., None].expand(-1, -1, 3)).save(tmp_path / "m.glb")

    def edit(text: bytes) -> bytes:
        tree = json.loads(text)
        primitive, slot = tree["meshes"][0]["primitives"][0], {"index": 0}
        names = ("diffuseTexture", "specularGlossinessTexture", "specularFactor")
        tree["materials"] = [
            {
                "extensions": {
                    "KHR_materials_pbrSpecularGlossiness": dict(zip(names, (slot, slot, [n / 90] * 3), strict=True))
                }
            }
            if is_old
            else {"pbrMetallicRoughness": {"baseColorTexture": slot, "baseColorFactor": [1, 1, n / 90, 1]}}
            for n in range(80)
        ]
        tree["meshes"][0]["primitives"] = [{**primitive, "material": n} for n in range(80)]
        return json.dumps(tree).encode()

    (tmp_path / "m.glb").write_bytes(glb((tmp_path / "m.glb").read_bytes(), 0.0, edit))
    monkeypatch.delattr(GltfMaterial, "make")  # the sum is known before a picture is made
    with pytest.raises(ValueError, match="pixels in all, got more in small files"):
        nr.UVMesh.load(tmp_path / "m.glb")
