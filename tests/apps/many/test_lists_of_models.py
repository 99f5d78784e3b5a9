"""Lists of models: folders, lists, archives, names; and files that are hostile."""

from __future__ import annotations

import io
import os
import tarfile
import zipfile
from pathlib import Path

import pytest

import neural_renderer as nr
from neural_renderer.apps.many import models
from neural_renderer.apps.many.models import ModelFile, list_models, opened
from neural_renderer.meshes.uv_mesh import UVMesh

BALL = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def names(*inputs: Path) -> list[str]:
    return [model.name for model in list_models(inputs)]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    place = tmp_path / "all"
    for name in (
        "b.obj",
        "a/x.obj",
        "a/x.glb",
        "a.ply",
        "deep/er/Ünï code (1).v2.stl",
        ".hidden/y.obj",
        "a/readme.txt",
    ):
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_text(BALL)
    with zipfile.ZipFile(place / "pack.zip", "w") as pack:
        pack.writestr("car/car.obj", "mtllib car.mtl\nusemtl red\n" + BALL)
        pack.writestr("car/car.mtl", "newmtl red\nKd 1 0 0\n")
        pack.writestr("bus.obj", BALL)
        pack.writestr("inner.zip", b"PK")
    return place


def test_a_folder(folder: Path) -> None:
    found = names(folder)
    assert found == sorted(found)
    assert set(found) == {
        "b",
        "a/x_obj",
        "a/x_glb",
        "a_ply",  # there are models in a folder a
        "deep/er/Ünï_code_1_v2",
        "pack/car/car",
        "pack/bus",
        "pack/inner",  # an archive in it has a line, and cannot be opened
    }
    assert "all/b" in names(folder, folder / "a" / "x.obj")


def test_lists(folder: Path, tmp_path: Path) -> None:
    text = tmp_path / "some.txt"
    text.write_text("all/b.obj\n\nall/pack.zip\n")
    assert names(text) == ["all/b", "all/pack/bus", "all/pack/car/car", "all/pack/inner"]
    table = tmp_path / "some.csv"
    table.write_text("uid,path,name\n7,all/b.obj,first\n8,all/b.obj,first\n9,all/a/x.obj,\n")
    assert names(table) == ["all/a/x", "first_obj", "first_obj_2"]
    table.write_text("path,member\nall/pack.zip,bus.obj\n")
    assert list_models([table]) == [ModelFile("all/pack/bus", str(folder / "pack.zip"), "bus.obj")]
    parquet, pyarrow = pytest.importorskip("pyarrow.parquet"), pytest.importorskip("pyarrow")
    parquet.write_table(pyarrow.table({"path": ["all/b.obj"], "name": ["one"]}), tmp_path / "some.parquet")
    assert names(tmp_path / "some.parquet") == ["one"]
    (tmp_path / "bad.parquet").write_text("no table")
    for path, content, sentence in (
        (table, "uid\n7\n", "expected a column \"path\", got 'uid'"),
        (table, "Path;name\na;b\n", "expected a column \"path\", got 'Path;name'"),
        (table, "path\na,b\n", "line 2: expected 1 columns, got 2"),
        (text, "all/readme.md", "line 1: expected a folder with meshes, or a path that ends in .obj"),
        (tmp_path / "bad.parquet", None, "expected a table, got a file that cannot be read"),
        (tmp_path / "a.doc", "", "expected a folder, or a file that ends in"),
        (tmp_path / "empty.txt", "", "expected meshes"),
    ):
        if content is not None:
            path.write_text(content)
        with pytest.raises(ValueError, match=sentence):
            list_models([path])
    with pytest.raises(
        FileNotFoundError, match="expected a mesh, an archive, a list of them, or a folder, got nothing"
    ):
        list_models([tmp_path / "nowhere.obj"])


def test_bad_rows_fail_alone(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "none").mkdir()
    table = tmp_path / "some.csv"
    table.write_text("path,name\n\nall/b.obj,b\nREADME.md,\n,empty\nall/b.obj,c,d\nnone,\nall/deep,d\n")
    found = {model.name: model.problem for model in list_models([table])}
    suffixes = "expected a folder with meshes, or a path that ends in .obj, .glb, .gltf, .ply, .off, .stl, .zip, .tar, "
    suffixes += ".tar.gz, .tgz, got"
    assert found == {
        "b": "",
        "README": f"some.csv, line 4: {suffixes} 'README.md'",
        "empty": 'some.csv, line 5: expected a path in the column "path", got none',
        "c": "some.csv, line 6: expected 2 columns, got 3",
        "none": f"some.csv, line 7: {suffixes} 'none'",
        "d/er/Ünï_code_1_v2": "",  # a folder
    }
    [broken] = [model for model in list_models([table]) if model.name == "c"]
    with pytest.raises(ValueError, match="line 6: expected 2 columns, got 3"), opened(broken):
        pass
    text = tmp_path / "some.txt"
    text.write_text("# models\n\nall/b.obj\n")
    assert [(model.name, bool(model.problem)) for model in list_models([text])] == [("_models", True), ("all/b", False)]


def test_names_are_no_folders_of_others(tmp_path: Path) -> None:
    for name in ("a.obj", "a/b.obj", "a_obj/c.obj"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(BALL)
    assert names(tmp_path) == ["a/b", "a_obj/c", "a_obj_2"]


def test_a_folder_that_is_left_out(folder: Path) -> None:
    assert [model.name for model in list_models([folder], without=(folder / "a").resolve())] == [
        name.replace("a_ply", "a") for name in names(folder) if not name.startswith("a/")
    ]


def test_links_and_hidden_files_in_an_archive(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(BALL)
    os.link(tmp_path / "a.obj", tmp_path / "b.obj")
    (tmp_path / "c.obj").symlink_to("../a.obj")
    (tmp_path / "d.obj").symlink_to("/etc/hostname")  # nothing outside is read
    with tarfile.open(tmp_path / "links.tar", "w") as tar:
        tar.add(tmp_path / "c.obj", "./in/c.obj")
        tar.add(tmp_path / "d.obj", "d.obj")
        for name in ("a.obj", "b.obj"):
            tar.add(tmp_path / name, f"./{name}")
        tar.add(tmp_path / "a.obj", "__MACOSX/._a.obj")
    found = list_models([tmp_path / "links.tar"])
    assert [model.name for model in found] == ["a", "b", "in/c"]
    for model in found:
        with opened(model) as path:
            assert path.read_text() == BALL


def test_a_model_in_an_archive_has_its_materials(folder: Path) -> None:
    [car] = [model for model in list_models([folder]) if model.name == "pack/car/car"]
    with opened(car) as path:
        assert UVMesh.load(path).colors[0, 0].tolist() == [1.0, 0.0, 0.0]
    assert not path.exists()
    for suffix, mode in (("tar", "w"), ("tar.gz", "w:gz"), ("tgz", "w:gz")):
        with tarfile.open(folder / f"pack.{suffix}", mode) as tar:
            tar.add(folder / "b.obj", "./in/b.obj")
        [ball] = list_models([folder / f"pack.{suffix}"])
        assert ball.name == "in/b"
        with opened(ball) as path:
            assert nr.Mesh.load(path).num_faces == 1


def test_a_compressed_archive_has_a_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A megabyte may unpack to a gigabyte; what is beyond the limit is not unpacked."""
    monkeypatch.setattr(models, "_MOST_UNPACKED", 1 << 20)
    with tarfile.open(tmp_path / "bomb.tar.gz", "w:gz") as tar:
        for name, size in (("a.obj", 100), ("zeros.obj", 1 << 24), ("b.obj", 100)):
            info = tarfile.TarInfo(name)
            info.size = size
            tar.addfile(info, io.BytesIO(bytes(size)))
    with pytest.raises(ValueError, match=r"bomb.tar.gz: expected an archive, got .*more than"):
        list_models([tmp_path / "bomb.tar.gz"])


def test_archives_that_lie(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "out.zip", "w") as pack:
        pack.writestr("../../evil.obj", BALL)
    with tarfile.open(tmp_path / "links.tar", "w") as tar:
        link = tarfile.TarInfo("link.obj")
        link.type, link.linkname = tarfile.SYMTYPE, "/etc/passwd"
        tar.addfile(link)
    (tmp_path / "cut.zip").write_bytes(b"PK\3\4" + bytes(40))
    with zipfile.ZipFile(tmp_path / "nested.zip", "w") as pack:
        pack.write(tmp_path / "out.zip", "out.zip")
    [model] = list_models([tmp_path / "out.zip"])
    with pytest.raises(ValueError, match="which is outside"), opened(model):
        pass
    (tmp_path / "good.obj").write_text(BALL)
    for name, sentence in (
        ("links.tar", "expected meshes in the archive, got none"),
        ("cut.zip", "expected an archive, got one that cannot be read"),
        ("nested.zip", "expected meshes in the archive, got none"),
    ):
        with pytest.raises(ValueError, match=sentence):
            list_models([tmp_path / name])
        [model] = [found for found in list_models([tmp_path / "good.obj", tmp_path / name]) if found.problem]
        with pytest.raises(ValueError, match=sentence), opened(model):
            pass
    assert not (tmp_path.parent / "evil.obj").exists()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no pipes with names")
def test_pipes_are_not_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.obj")
    os.mkfifo(tmp_path / "pipe.zip")
    for model in list_models([tmp_path]):
        with pytest.raises((FileNotFoundError, ValueError), match="got a device or pipe"), opened(model):
            pass
    (tmp_path / "loop.obj").symlink_to("loop.obj")
    with pytest.raises(FileNotFoundError, match="got a link that leads nowhere"), opened(list_models([tmp_path])[0]):
        pass
