"""Files beside an OBJ: their names, and which of them a save may replace."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
import torch
from PIL import Image

import neural_renderer as nr
from tests.faults import contents


def ball(color: float = 1.0) -> nr.Mesh:
    vertices, faces = nr.icosphere(0)
    return nr.Mesh(vertices, faces, torch.full((len(faces), 2, 2, 2, 3), color))


def photo(path: Path) -> bytes:
    Image.new("RGB", (3, 3), "red").save(path)
    return path.read_bytes()


def refused(name: str, save: str = r"a\.obj") -> pytest.RaisesExc[FileExistsError]:
    sentence = rf"{name}: expected no file, or one that was written with {save}, got a foreign file; overwrite=True"
    return pytest.raises(FileExistsError, match=sentence)


def test_names(tmp_path: Path) -> None:
    ball().save(tmp_path / "new" / "a.obj")
    assert set(contents(tmp_path)) == {"new/a.obj", "new/a.mtl", "new/a_texture.png"}
    mesh = nr.UVMesh.load(tmp_path / "new" / "a.obj")
    mesh.save(tmp_path / "b.obj")
    several = dataclasses.replace(
        mesh, images=mesh.images * 2, wraps=mesh.wraps * 2, image_index=torch.arange(len(mesh.faces)) % 2
    )
    several.save(tmp_path / "c.obj")
    names = {"b.obj", "b.mtl", "b_texture.png", "c.obj", "c.mtl", "c_texture_1.png", "c_texture_2.png"}
    assert {path.name for path in tmp_path.iterdir()} == names | {"new"}


@pytest.mark.parametrize("name", ["a.png", "a_texture.jpg", "texture.png", "a_texture_1.png", "b.mtl"])
def test_pictures_of_other_names_are_left_alone(tmp_path: Path, name: str) -> None:
    before = photo(tmp_path / name) if name.endswith("png") else (tmp_path / name).write_bytes(b"b") and b"b"
    ball().save(tmp_path / "a.obj")
    assert (tmp_path / name).read_bytes() == before


@pytest.mark.parametrize(("name", "save"), [("a_texture.png", "mesh"), ("a.png", "save_obj"), ("a.mtl", "mesh")])
def test_what_others_made_is_replaced_only_when_asked(tmp_path: Path, name: str, save: str) -> None:
    def saved(**options: bool) -> None:
        mesh = ball()
        if save == "mesh":
            mesh.save(tmp_path / "a.obj", **options)
        else:
            nr.save_obj(tmp_path / "a.obj", mesh.vertices, mesh.faces, mesh.textures, **options)

    (tmp_path / "a.obj").write_text("o somebody's\n")
    (tmp_path / "a.mtl").write_text("newmtl wood\nmap_Kd a.png\n")
    if name.endswith("png"):
        photo(tmp_path / name)
    before = contents(tmp_path)
    with refused(r"a\.mtl"):
        saved()
    assert contents(tmp_path) == before
    (tmp_path / "a.mtl").unlink()
    if name != "a.mtl":
        with refused(name):
            saved()
        assert (tmp_path / name).read_bytes() == before[name]
    saved(overwrite=True)
    assert (tmp_path / name).read_bytes() != before.get(name)
    saved()  # by now it is ours


def test_a_save_replaces_its_own(tmp_path: Path) -> None:
    ball(0.2).save(tmp_path / "a.obj")
    ball(0.8).save(tmp_path / "a.obj")
    assert nr.Mesh.load(tmp_path / "a.obj").textures.min() > 0.79
    kept = photo(tmp_path / "a_texture.png")
    with refused(r"a_texture\.png"):  # somebody has put a picture there meanwhile
        ball().save(tmp_path / "a.obj")
    assert (tmp_path / "a_texture.png").read_bytes() == kept


def test_the_texture_of_another_mesh(tmp_path: Path) -> None:
    mesh = ball()
    nr.save_obj(tmp_path / "a_texture.obj", mesh.vertices, mesh.faces, mesh.textures)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert set(before) == {"a_texture.obj", "a_texture.mtl", "a_texture.png"}
    with refused(r"a_texture\.png"):
        mesh.save(tmp_path / "a.obj")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_mesh_without_colours_needs_no_other_names(tmp_path: Path) -> None:
    before = photo(tmp_path / "a.png"), photo(tmp_path / "a_texture.png")
    (tmp_path / "a.mtl").write_text("somebody's")
    nr.save_mesh(tmp_path / "a.obj", *nr.icosphere(0))
    assert ((tmp_path / "a.png").read_bytes(), (tmp_path / "a_texture.png").read_bytes()) == before
    assert (tmp_path / "a.mtl").read_text() == "somebody's"


def test_files_of_the_first_packages_are_replaced_as_ever(tmp_path: Path) -> None:
    """They have no note, but a material file that nobody else writes like this."""
    (tmp_path / "my a.mtl").write_text("newmtl material_1\nmap_Kd my a.png\n")
    photo(tmp_path / "my a.png")
    mesh = ball(0.5)
    nr.save_obj(str(tmp_path / "my a.obj"), mesh.vertices, mesh.faces, mesh.textures)
    assert nr.load_obj(tmp_path / "my a.obj", load_texture=True)[2].sub(0.5).abs().max() < 0.01


@pytest.mark.parametrize("name", ["a\\b.obj", "a\nb.obj", "ab\udcff.obj"])
def test_names_that_an_obj_cannot_hold(tmp_path: Path, name: str) -> None:
    vertices, faces = nr.cube()
    with pytest.raises(ValueError, match="expected a name that an OBJ file can hold"):
        nr.save_obj(tmp_path / name, vertices, faces, torch.ones(12, 1, 1, 1, 3))
    assert not list(tmp_path.iterdir())
