"""STL and OFF files: their variants, their colours, and what is refused."""

from __future__ import annotations

import struct
import warnings
from pathlib import Path

import pytest
import torch

import neural_renderer as nr
from tests.io.polygon_reader import difference

FACES = [[(0.0, 0, 0), (1.0, 0, 0), (1.0, 1, 0)], [(0.0, 0, 0), (1.0, 1, 0), (0.0, 1, 0)]]
POINTS = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"


def binary(path: Path, count: int = 2, head: bytes = b"", more: bytes = b"") -> Path:
    rows = b"".join(struct.pack("<12fH", 0, 0, 1, *(value for corner in face for value in corner), 7) for face in FACES)
    path.write_bytes(head.ljust(80) + struct.pack("<I", count) + rows + more)
    return path


def text(path: Path, ends: str = "\n", name: str = "vertex of mine") -> Path:
    lines = [f"solid {name}"]
    for face in FACES:
        corners = [f"   VERTEX {x} {y:e}\t{z}" for x, y, z in face]
        lines += ["facet normal 0 0 1", " outer loop", *corners, " endloop", "endfacet"]
    path.write_text(ends.join([*lines, f"endsolid {name}", "solid", "endsolid", ""]), newline="")
    return path


@pytest.mark.parametrize("more", [b"", b"\0", b"made by a program" * 9])
@pytest.mark.parametrize("head", [b"", b"solid by a program", b"\xff" * 80])
def test_binary_stl(tmp_path: Path, head: bytes, more: bytes) -> None:
    """Bytes after the last triangle are ignored, and the header may begin like a text."""
    path = binary(tmp_path / "m.stl", head=head, more=more)
    vertices, faces, textures = nr.load_mesh(path)
    assert vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]] and textures is None
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3]] and difference(path) == "right"


@pytest.mark.parametrize("ends", ["\n", "\r\n", "\r"])
def test_text_stl(tmp_path: Path, ends: str) -> None:
    vertices, faces, _ = nr.load_mesh(text(tmp_path / "m.stl", ends))
    assert vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]] and faces.tolist() == [
        [0, 1, 2],
        [0, 2, 3],
    ]


def test_damaged_stl(tmp_path: Path) -> None:
    path = tmp_path / "m.stl"
    refused = {
        b"": "expected STL, which begins with solid or has 84 bytes, got 0 bytes",
        b"solid a": "expected faces, got 0 vertices",
        b"solid\nvertex 1 2 x\n": r"expected 3 numbers in vertex 0, got '1 2 x'",
        b"solid\nvertex 1 2\n": r"expected 3 numbers in vertex 0, got '1 2'",
        b"solid\nvertex 1 2 3\n": "expected three vertices for each face, got 1 vertices; the file is cut",
        b"solid\n" + b"vertex 1 2 1e39\n" * 3: "expected finite vertices that float32 can hold, got 3 bad numbers",
        binary(path, 3).read_bytes(): "expected 3 triangles of 50 bytes after the first 84, got 100 bytes",
        binary(path, 0).read_bytes(): "expected faces, got 0 vertices",
        binary(path, 3, b"solid by a program").read_bytes(): "expected vertices as text, or 3 triangles of 50 bytes",
    }
    for data, sentence in refused.items():
        path.write_bytes(data)
        with pytest.raises(ValueError, match=rf"m\.stl: {sentence}"):
            nr.load_mesh(path)


@pytest.mark.parametrize(
    "header", ["OFF\n4 2 5\n", "OFF 4 2 5\n", "OFF4 2 5\n", "4 2 5\n", "# by hand\n\n OFF # so\n4 2\n"]
)
def test_headers_of_off(tmp_path: Path, header: str) -> None:
    path = tmp_path / "m.off"
    path.write_text(f"{header}{POINTS}# faces\n3 0 1 2\n3 0 2 3 # the last\n")
    vertices, faces, textures = nr.load_mesh(path)
    assert vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]] and textures is None
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3]] and difference(path) == "right"
    path.write_text(f"{header}{POINTS}4 0 1\n2 3\n3 0 2\n3\n")  # broken at other places
    assert nr.load_mesh(path)[1].tolist() == [[0, 1, 2], [0, 2, 3], [0, 2, 3]]


@pytest.mark.parametrize("header", ["COFF\n4 2 0\n", "COFF 4 2 0\n", "CNOFF\n4 2 0\n", "STCNOFF\n4 2 0\n"])
@pytest.mark.parametrize(
    "colors", [("255 0 0 255", "0 255 0 128"), ("1.0 0 0 1", "0 1.0 0 0.5"), ("1 0 0 1", "0 1 0 1")]
)
def test_colours_of_vertices_in_off(tmp_path: Path, header: str, colors: tuple[str, str]) -> None:
    normal, uv = "0 0 1 " * ("N" in header), " 0.25 0.75" * header.startswith("ST")
    rows = [f"{row} {normal}{colors[number % 2]}{uv}" for number, row in enumerate(POINTS.splitlines())]
    (tmp_path / "m.off").write_text(header + "\n".join(rows) + "\n3 0 1 2\n3 0 2 3\n")
    textures = nr.load_mesh(tmp_path / "m.off", 1)[2]
    assert textures is not None
    torch.testing.assert_close(textures[:, 0, 0, 0], torch.tensor([[2.0, 1, 0], [2.0, 1, 0]]) / 3)


def test_colours_of_faces_in_off(tmp_path: Path) -> None:
    """A face without a colour is white, or has those of its vertices."""
    path = tmp_path / "m.off"
    path.write_text(f"OFF\n4 3 0\n{POINTS}3 0 1 2 255 0 0\n4 0 1 2 3 0 0 51 255\n3 0 2 3\n")
    textures = nr.load_mesh(path, 1)[2]
    assert textures is not None
    expected = torch.tensor([[1.0, 0, 0], [0, 0, 0.2], [0, 0, 0.2], [1, 1, 1]])
    torch.testing.assert_close(textures[:, 0, 0, 0], expected)
    path.write_text(f"OFF\n4 2 0\n{POINTS}3 0 1 2 1.0 0.0 0.5\n3 0 2 3 0.5 1 0\n")
    textures = nr.load_mesh(path, 1)[2]
    assert textures is not None and textures[:, 0, 0, 0].tolist() == [[1, 0, 0.5], [0.5, 1, 0]]


def test_sentences_about_what_off_files_lose(tmp_path: Path) -> None:
    path = tmp_path / "m.off"
    path.write_text(f"OFF\n4 2 0\n{POINTS}3 0 1 2 5\n3 0 2 3 6\n")
    with pytest.warns(UserWarning, match=r"m\.off: 2 faces have a place in a colour map as their colour"):
        assert nr.load_mesh(path)[2] is None
    path.write_text("OFF\n3 1 0\n0 0 0 255 0 0\n1 0 0 255 0 0\n1 1 0 255 0 0\n3 0 1 2\n")
    with pytest.warns(UserWarning, match=r"m\.off: its vertices have 6 numbers each, but without COFF only the first"):
        assert nr.load_mesh(path)[2] is None
    path.write_text(f"OFF\n4 2 0\n{POINTS}2 0 1\n3 0 2 3\n")
    with pytest.warns(UserWarning, match=r"m\.off: 1 faces of fewer than three corners are left out"):
        assert nr.load_mesh(path)[1].tolist() == [[0, 2, 3]]


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("", "expected OFF and the numbers of vertices and faces, got nothing"),
        ("OFF", "expected OFF and the numbers of vertices and faces, got nothing"),
        ("OFF\nx y z\n", "expected OFF and the numbers of vertices and faces, got 'x y z'"),
        ("OFF BINARY\n4 2 0\n", "expected an OFF file of three dimensions as text, got 'OFF BINARY'"),
        ("4OFF\n4 2 0\n", "expected an OFF file of three dimensions as text, got '4OFF'"),
        ("nOFF\n2\n4 2 0\n", "expected an OFF file of three dimensions as text, got 'nOFF'"),
        (
            f"OFF\n4 2 0\n{POINTS}3 0 1 2\n",
            "expected 4 vertices and 2 faces, each in a line, got 5 lines; the file is cut",
        ),
        ("OFF\n3 1 0\n0 0\n1 0 0\n1 1 0\n3 0 1 2\n", "expected 3 numbers in vertex 0, got '0 0'"),
        (f"OFF\n4 1 0\n{POINTS}3 0 1 4\n", "expected indices of its 4 vertices, counted from 0, got 4"),
        (f"OFF\n4 1 0\n{POINTS}3 0 1 -1\n", "expected indices of its 4 vertices, counted from 0, got -1"),
        (f"OFF\n4 1 0\n{POINTS}3 0 1 x\n", "expected 1 numbers in corner 2, got 'x'"),
        (f"OFF\n4 1 0\n{POINTS}three 0 1 2\n", "expected a count and as many vertices in face 0, got 'three 0 1 2'"),
        (f"OFF\n4 0 0\n{POINTS}", "expected faces, got 4 vertices but no faces"),
        ("COFF\n3 1 0\n0 0 0 1\n1 0 0 1\n1 1 0 1\n3 0 1 2\n", "expected 3 numbers in the colour of vertex 0, got '1'"),
    ],
)
def test_damaged_off(tmp_path: Path, content: str, sentence: str) -> None:
    (tmp_path / "m.off").write_text(content)
    with pytest.raises(ValueError, match=rf"m\.off: {sentence}"):
        nr.load_mesh(tmp_path / "m.off")


@pytest.mark.parametrize("name", ["m.off", "m.stl"])
def test_cut_at_any_place(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    if name == "m.off":
        path.write_text("COFF\n3 1 0\n0 0 0 1 0 0\n1 0 0 0 1 0\n1 1 0 0 0 1\n3 0 1 2")
    else:
        binary(path)
    data = path.read_bytes()
    for length in range(len(data)):
        path.write_bytes(data[:length])
        with warnings.catch_warnings(), pytest.raises(ValueError, match=rf"{name}: expected"):
            warnings.simplefilter("ignore")
            nr.load_mesh(path)


@pytest.mark.parametrize("begin", [b" ", b"\r\n\t", b"\xef\xbb\xbf"])
def test_stl_text_after_blanks(tmp_path: Path, begin: bytes) -> None:
    corners = b"".join(b" vertex %d %d 0\r\n" % place for place in ((0, 0), (1, 0), (0, 1)))
    (tmp_path / "m.stl").write_bytes(
        begin + b"solid a\r\n facet normal 0 0 1\r\n outer loop\r\n" + corners + b" endloop\r\n"
    )
    vertices, faces, _ = nr.load_mesh(tmp_path / "m.stl")
    assert vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]] and faces.tolist() == [[0, 1, 2]]
