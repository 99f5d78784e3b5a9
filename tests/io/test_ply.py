"""PLY files by every variant of the format, against values by hand and the independent reader."""

from __future__ import annotations

import struct
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import neural_renderer as nr
from tests.io.polygon_reader import SUFFIXES, difference

ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
CODES = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"}
SQUARE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]


def write(
    path: Path,
    elements: list[tuple[str, list[str], list[list[Any]]]],
    kind: str = "ascii",
    comments: tuple[str, ...] = (),
    end: str = "\n",
) -> Path:
    """Write a file: of each element its name, its properties as in the header, and its rows."""
    header = ["ply", f"format {kind} 1.0", *(f"comment {text}" for text in comments)]
    body, order = b"", ORDERS[kind]
    for name, properties, rows in elements:
        header += [f"element {name} {len(rows)}", *(f"property {text}" for text in properties)]
        for row in rows:
            parts: list[tuple[str, Any]] = []
            for text, value in zip(properties, row, strict=True):
                words = text.split()
                if words[0] == "list":
                    parts += [(words[1], len(value)), *((words[2], item) for item in value)]
                else:
                    parts.append((words[0], value))
            if order:
                body += b"".join(struct.pack(order + CODES[kind], value) for kind, value in parts)
            else:
                body += (" ".join(str(value) for _, value in parts) + end).encode()
    path.write_bytes((end.join([*header, "end_header"]) + end).encode() + body)
    return path


def vertices(extra: list[str] = [], values: Any = None, points: Any = SQUARE, of: str = "float") -> Any:  # noqa: B006
    """Make the element vertex, with more properties."""
    rows = [[*point, *(values[number] if values else ())] for number, point in enumerate(points)]
    return "vertex", [*(f"{of} {axis}" for axis in "xyz"), *extra], rows


def faces(rows: Any = ((0, 1, 2), (0, 2, 3)), kind: str = "list uchar int", extra: Any = (), values: Any = None) -> Any:
    """Make the element face, with more properties."""
    own = [[list(row), *(values[number] if values else ())] for number, row in enumerate(rows)]
    return "face", [f"{kind} vertex_indices", *extra], own


@pytest.mark.parametrize("kind", ORDERS)
@pytest.mark.parametrize("count", ["uchar", "char", "ushort", "short", "int", "uint"])
@pytest.mark.parametrize("index", ["uchar", "char", "short", "ushort", "int", "uint"])
def test_lists_of_any_type_whose_lengths_differ(tmp_path: Path, kind: str, count: str, index: str) -> None:
    rows = [(0, 1, 2), (0, 1, 2, 3), (2, 3, 0), (3, 2, 1, 0), (1, 2, 3)]
    path = write(tmp_path / "m.ply", [vertices(of="double"), faces(rows, f"list {count} {index}")], kind)
    points, corners, textures = nr.load_mesh(path)
    assert points.tolist() == [list(map(float, point)) for point in SQUARE] and textures is None
    expected = [[0, 1, 2], [0, 1, 2], [0, 2, 3], [2, 3, 0], [3, 2, 1], [3, 1, 0], [1, 2, 3]]
    assert corners.tolist() == expected and corners.dtype == torch.int32
    assert difference(path) == "right"


@pytest.mark.parametrize("kind", ORDERS)
def test_unknown_elements_and_properties_are_skipped(tmp_path: Path, kind: str) -> None:
    """Also lists before, between and after the corners, and in an element that nobody knows."""
    odd = ("odd", ["list uchar double a", "short b", "list int uchar c"], [[[1.5], -1, [1, 2, 3]], [[], 7, []]])
    extra, values = ["uchar flag", "list uchar float weights", "double area"], [[1, [0.5], 2.0], [0, [], 3.0]]
    elements = [odd, vertices(["list uchar int near", "float w"], [[[1, 2], 5.0], [[], 6.0], [[3], 7.0], [[], 8.0]])]
    path = write(tmp_path / "m.ply", [*elements, faces(extra=extra, values=values), odd], kind)
    points, corners, textures = nr.load_mesh(path)
    assert points.tolist() == [list(map(float, point)) for point in SQUARE] and textures is None
    assert corners.tolist() == [[0, 1, 2], [0, 2, 3]] and difference(path) == "right"


@pytest.mark.parametrize("kind", ORDERS)
@pytest.mark.parametrize("index", ["int", "short", "uint"])
def test_strips(tmp_path: Path, kind: str, index: str) -> None:
    end = 2**32 - 1 if index == "uint" and kind != "ascii" else -1
    if index == "uint" and kind == "ascii":
        index = "int"
    strips = ("tristrips", [f"list int {index} vertex_indices"], [[[0, 1, 3, 2, end, 0, 1, 2, 2, 3, 0]], [[1, 2, 3]]])
    path = write(tmp_path / "m.ply", [vertices(), strips], kind)
    expected = [[0, 1, 3], [3, 1, 2], [0, 1, 2], [3, 2, 0], [1, 2, 3]]
    found = nr.load_mesh(path)[1].tolist()
    turned = [[row[k:] + row[:k] for k in range(3)] for row in found]
    assert len(found) == len(expected) and all(row in rows for row, rows in zip(expected, turned, strict=True))
    both = write(tmp_path / "both.ply", [vertices(), faces([(3, 2, 1, 0)]), strips], kind)
    assert nr.load_mesh(both)[1].tolist() == [[3, 2, 1], [3, 1, 0], *found]


@pytest.mark.parametrize("kind", ORDERS)
@pytest.mark.parametrize(
    "names", [("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue")]
)
@pytest.mark.parametrize(("of", "top"), [("uchar", 255), ("ushort", 65535), ("float", 1.0), ("double", 1.0)])
def test_colours_of_vertices(tmp_path: Path, kind: str, names: Any, of: str, top: float) -> None:
    rows = [[top, 0, 0], [0, top, 0], [0, 0, top], [top, top, 0]]
    path = write(tmp_path / "m.ply", [vertices([f"{of} {name}" for name in names], rows), faces()], kind)
    textures = nr.load_mesh(path, 1)[2]
    assert textures is not None
    torch.testing.assert_close(textures[:, 0, 0, 0], torch.tensor([[1.0, 1, 1], [2.0, 1, 1]]) / 3)
    assert difference(path) == "right"


@pytest.mark.parametrize("of", ["uchar", "ushort", "float"])
def test_colours_of_faces(tmp_path: Path, of: str) -> None:
    top = {"uchar": 255, "ushort": 65535, "float": 1.0}[of]
    extra = [f"{of} {name}" for name in ("red", "green", "blue", "alpha")]
    rows = [(0, 1, 2, 3), (0, 1, 2)]
    path = write(
        tmp_path / "m.ply", [vertices(), faces(rows, extra=extra, values=[[top, 0, 0, top], [0, 0, top, top]])]
    )
    textures = nr.load_mesh(path, 1)[2]
    assert textures is not None and textures[:, 0, 0, 0].tolist() == [[1, 0, 0], [1, 0, 0], [0, 0, 1]]


@pytest.mark.parametrize(
    ("of", "top", "end"),
    [("float", 255.0, 255), ("double", 65535.0, 65535), ("ushort", 255, 255), ("int", 65535, 65535)],
)
def test_a_sentence_tells_of_colours_whose_range_is_a_guess(tmp_path: Path, of: str, top: float, end: int) -> None:
    extra = [f"{of} {name}" for name in ("red", "green", "blue")]
    path = write(tmp_path / "m.ply", [vertices(extra, [[top, top // 2, 0]] * 4), faces()])
    with pytest.warns(UserWarning, match=rf"m\.ply: its colours reach {top:g}; they are read as 0 … {end}"):
        textures = nr.load_mesh(path, 1)[2]
    assert textures is not None
    torch.testing.assert_close(textures[0, 0, 0, 0], torch.tensor([1.0, (top // 2) / top, 0.0]))


def pictures(folder: Path) -> None:
    for name, color in (("a.png", (1.0, 0, 0)), ("b c.png", (0, 0, 1.0))):
        nr.save_image(folder / name, torch.tensor(color).expand(4, 4, 3))


COMMENTS = ("TextureFile a.png", "TextureFile b c.png")


@pytest.mark.parametrize("kind", ORDERS)
def test_texture_coordinates_by_face_with_several_pictures(tmp_path: Path, kind: str) -> None:
    """A face without coordinates, or with the number −1, has the colour of its vertices."""
    pictures(tmp_path)
    rows = [(0, 1, 2, 3), (0, 1, 2), (1, 2, 3), (2, 3, 0)]
    square, triangle = [0, 0, 1, 0, 1, 1, 0, 1], [0, 0, 1, 0, 1, 1]
    values = [[square, 1], [triangle, 0], [[], 0], [triangle, -1]]
    element = faces(rows, extra=["list uchar float texcoord", "int texnumber"], values=values)
    green = vertices(["uchar red", "uchar green", "uchar blue"], [[0, 255, 0]] * 4)
    path = write(tmp_path / "m.ply", [green, element], kind, COMMENTS)
    mesh = nr.UVMesh.load(path)
    assert mesh.image_index.tolist() == [1, 1, 0, -1, -1]
    assert mesh.uv[:3].tolist() == [[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]], [[0, 0], [1, 0], [1, 1]]]
    colors = nr.load_mesh(path, 1)[2]
    assert colors is not None
    assert colors[:, 0, 0, 0].tolist() == [[0, 0, 1], [0, 0, 1], [1, 0, 0], [0, 1, 0], [0, 1, 0]]


@pytest.mark.parametrize("names", [("s", "t"), ("u", "v"), ("texture_u", "texture_v")])
def test_texture_coordinates_by_vertex(tmp_path: Path, names: tuple[str, str]) -> None:
    pictures(tmp_path)
    extra = [*(f"float {name}" for name in names), "int texnumber"]
    path = write(
        tmp_path / "m.ply", [vertices(extra, [[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]), faces()], comments=COMMENTS
    )
    mesh = nr.UVMesh.load(path)
    assert mesh.image_index.tolist() == [0, 0] and mesh.uv[1].tolist() == [[0, 0], [1, 1], [0, 1]]
    colors = nr.load_mesh(path, 1)[2]
    assert colors is not None and colors[:, 0, 0, 0].tolist() == [[0, 0, 1]] * 2
    plain = write(tmp_path / "plain.ply", [vertices(extra[:2], [[0, 0], [1, 0], [1, 1], [0, 1]]), faces()])
    assert nr.load_mesh(plain)[2] is None
    kept = nr.UVMesh.load(plain, grey=0.25)
    assert torch.equal(kept.uv, mesh.uv) and bool((kept.colors == 0.25).all())


def test_what_is_missing_is_told(tmp_path: Path) -> None:
    pictures(tmp_path)
    uv = ["float s", "float t"], [[0, 0], [1, 0], [1, 1], [0, 1]]
    lost = write(tmp_path / "lost.ply", [vertices(*uv), faces()], comments=("TextureFile lost.png",))
    with pytest.warns(UserWarning, match=r"lost\.ply: its file 'lost\.png' is missing"):
        textures = nr.load_mesh(lost, 1)[2]
    assert textures is not None and bool((textures == 1).all())
    none = write(tmp_path / "none.ply", [vertices(), faces()], comments=("TextureFile a.png",))
    with pytest.warns(UserWarning, match=r"none\.ply: its picture is not shown, because .* no texture coordinates"):
        nr.load_mesh(none, 1)
    many = faces(extra=["int texnumber"], values=[[0], [5]])
    with pytest.warns(UserWarning, match="1 faces have a texnumber of at least 1"):
        nr.load_mesh(write(tmp_path / "m.ply", [vertices(*uv), many], comments=("TextureFile a.png",)))
    small = write(tmp_path / "small.ply", [vertices(), faces([(0, 1), (0, 1, 2), (), (3,)])])
    with pytest.warns(UserWarning, match=r"small\.ply: 3 faces of fewer than three corners are left out"):
        assert nr.load_mesh(small)[1].tolist() == [[0, 1, 2]]
    outside = write(tmp_path / "out.ply", [vertices(*uv), faces()], comments=("TextureFile ../lost.png",))
    with pytest.raises(ValueError, match=r"out\.ply: expected names of files in its folder"):
        nr.load_mesh(outside)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("kind", ORDERS)
def test_ends_of_lines(tmp_path: Path, kind: str, end: str) -> None:
    """The first number of the binary file begins with the byte of a line's end."""
    first = float(np.frombuffer(b"\n\n\n\n", "<f4" if kind.endswith("little_endian") else ">f4")[0])
    points = [(first, 0.0, 0.0), *SQUARE[1:]]
    comments = ("made by hand", "TextureFile") if end == "\n" else ("ä",)
    path = write(tmp_path / "m.ply", [vertices(points=points), faces()], kind, comments, end)
    found, corners, _ = nr.load_mesh(path)
    assert found[0, 0] == np.float32(first) and corners.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_text_that_is_not_in_lines_or_has_more_in_a_line(tmp_path: Path) -> None:
    header = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    header += "element face 2\nproperty list uchar int vertex_index\nend_header\n"
    free, long = tmp_path / "free.ply", tmp_path / "long.ply"
    free.write_text(header + "0 0 0 1 0\n0 1 1\n0 0 1 0 3\n\n0 1 2 3 0 2 3\nmore text")
    assert nr.load_mesh(free)[1].tolist() == [[0, 1, 2], [0, 2, 3]]
    long.write_text(header + "0 0 0 7\n1 0 0 7\n1 1 0 7\n0 1 0 7\n3 0 1 2 9 1\n3 0 2 3 9 1\n")
    with pytest.warns(UserWarning, match=r"long\.ply: 6 lines have more numbers than their properties"):
        points, corners, _ = nr.load_mesh(long)
    assert points.tolist() == [list(map(float, point)) for point in SQUARE]
    assert corners.tolist() == [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "expected the first line \"ply\", got ''"),
        ("ply\n", 'expected a header that ends with "end_header"'),
        ("ply\nend_header\n", "expected a line with the format in the header, got none"),
        ("ply\nformat text 1.0\nend_header\n", "line 2: expected a format out of ascii, binary_little_endian"),
        ("ply\nformat ascii 1.0\nproperty int x\nend_header\n", "line 3: expected an element before its properties"),
        ("ply\nformat ascii 1.0\nelement vertex -1\nend_header\n", "line 3: expected a name and a number of rows"),
        ("ply\nformat ascii 1.0\nelement vertex\nend_header\n", "line 3: expected a name and a number of rows"),
        ("ply\nformat ascii 1.0\nelement v 1\nproperty half x\nend_header\n1", "line 4: expected a type, or list and"),
        ("ply\nformat ascii 1.0\nelement v 1\nproprety int x\nend_header\n1", "line 4: expected element, property or"),
        (
            "ply\nformat ascii 1.0\nelement v 1\nproperty int x\nend_header\n1",
            "expected an element vertex with x, y and",
        ),
        ("ply\nformat ascii 1.0\nelement v 9999\nproperty int x\nend_header\n1", "expected at least 9999 numbers"),
        ("ply\nformat binary_little_endian 1.0\nelement v 99999999\nproperty int x\nend_header\n1", "the file is cut"),
    ],
)
def test_damaged_headers(tmp_path: Path, text: str, sentence: str) -> None:
    (tmp_path / "m.ply").write_text(text)
    with pytest.raises(ValueError, match=rf"m\.ply.*{sentence}"):
        nr.load_mesh(tmp_path / "m.ply")


@pytest.mark.parametrize("kind", ORDERS)
@pytest.mark.parametrize(
    ("element", "sentence"),
    [
        (faces([(0, 1, 4)]), "expected indices of its 4 vertices, counted from 0, got 4"),
        (faces([(0, 1, 2), (0, 1, 2, -1)]), "expected indices of its 4 vertices, counted from 0, got -1"),
        (faces([(0, 1, 1.5)], "list uchar float"), "expected whole numbers as indices of vertices, got 1.5"),
        (faces([]), "expected faces, got 4 vertices but no faces"),
        (
            faces(extra=["list uchar float texcoord"], values=[[[0, 0]], [[]]]),
            "expected 6 numbers in the texcoord of face 0",
        ),
        (("face", ["int vertex_indices"], [[1]]), "expected lists as vertex_indices of face, got numbers"),
        (("face", ["int flags"], [[1]]), "expected vertex_indices in the element face, got none"),
    ],
)
def test_damaged_faces(tmp_path: Path, kind: str, element: Any, sentence: str) -> None:
    with pytest.raises(ValueError, match=rf"m\.ply: {sentence}"):
        nr.load_mesh(write(tmp_path / "m.ply", [vertices(), element], kind))


@pytest.mark.parametrize("count", ["char", "float", "int"])
def test_counts_that_are_none(tmp_path: Path, count: str) -> None:
    path = write(
        tmp_path / "m.ply", [vertices(), faces([(0, 1, 2, 3), (0, 1, 2)], f"list {count} int")], "binary_big_endian"
    )
    data = bytearray(path.read_bytes())
    width = struct.calcsize(CODES[count])
    data[-12 - width : -12] = struct.pack(">" + CODES[count], {"float": 2.5}.get(count, -3))
    path.write_bytes(data)
    with pytest.raises(
        ValueError, match=r"m\.ply: expected (lists of at least 0 numbers in face, got a count of|2 rows)"
    ):
        nr.load_mesh(path)


@pytest.mark.parametrize("kind", ORDERS)
def test_cut_at_any_place(tmp_path: Path, kind: str) -> None:
    rows = [(0, 1, 2), (0, 1, 2, 3), (1, 2, 3)]
    path = write(tmp_path / "m.ply", [vertices(), faces(rows)], kind)
    data = path.read_bytes()
    for length in range(len(data) - (2 if kind == "ascii" else 1)):  # the last digit and the end of its line
        path.write_bytes(data[:length])
        with warnings.catch_warnings(), pytest.raises(ValueError, match=r"m\.ply") as error:
            warnings.simplefilter("ignore")
            nr.load_mesh(path)
        assert "expected" in str(error.value)


def test_a_large_file_takes_three_times_its_memory(tmp_path: Path) -> None:
    """Numbers are read as the file has them: 12 bytes for each vertex and each face, beside the file."""
    import tracemalloc

    count = 200_000
    row = np.empty(count, np.dtype([("count", "u1"), ("corners", "<i4", 3)]))
    row["count"], row["corners"] = 3, np.arange(3 * count).reshape(-1, 3) % 1000
    header = "ply\nformat binary_little_endian 1.0\nelement vertex 1000\nproperty float x\nproperty float y\n"
    header += f"property float z\nelement face {count}\nproperty list uchar int vertex_indices\nend_header\n"
    points = np.random.default_rng(0).random((1000, 3), np.float32)
    (tmp_path / "m.ply").write_bytes(header.encode() + points.tobytes() + row.tobytes())
    tracemalloc.start()
    try:
        found = nr.load_mesh(tmp_path / "m.ply")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert np.array_equal(found[1].numpy(), row["corners"]) and np.array_equal(found[0].numpy(), points)
    assert peak < 3 * (tmp_path / "m.ply").stat().st_size


@pytest.mark.slow
def test_files_of_others(shared: Path) -> None:
    """Every file is right, or refused where the independent reader refuses it, too."""
    paths = [path for path in sorted((shared / "data").rglob("*")) if path.suffix.lower() in SUFFIXES]
    paths = [path for path in paths if path.stat().st_size < 5_000_000]
    assert len(paths) > 10
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        wrong = {str(path): found for path in paths if (found := difference(path)).startswith("wrong")}
    assert not wrong
