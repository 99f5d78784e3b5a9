"""Files that name files: files outside their folder are read on request only, devices and pipes never."""

from __future__ import annotations

import json
import os
import shutil
import warnings
from pathlib import Path

import pytest
import torch
import trimesh

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.common.saved_tensors import why_not_loaded
from neural_renderer.io.named_files import find_file, is_outside

HINT = r"which is outside; allow_outside=True"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Red pictures in the folder "beside", and one, green, below the folder "home" of the meshes."""
    red = torch.tensor([1.0, 0, 0]).expand(2, 2, 3).numpy()
    nr.save_image(tmp_path / "beside" / "red.png", red)
    nr.save_image(tmp_path / "home" / "inner" / "green.png", red[..., [1, 0, 2]].copy())
    return tmp_path


def obj(folder: Path, image: str, library: str = "m.mtl") -> Path:
    path = folder / "home" / "m.obj"
    uv = "vt 0 0\nvt 1 0\nvt 0 1\n"
    path.write_text(f"mtllib {library}\nv 0 0 0\nv 1 0 0\nv 0 1 0\n{uv}usemtl m\nf 1/1 2/2 3/3\n")
    target = folder / "home" / library
    target.parent.mkdir(exist_ok=True, parents=True)
    target.write_text(f"newmtl m\nmap_Kd {image}\n")
    return path


def gltf(folder: Path, image: str) -> Path:
    """The same triangle as glTF with a buffer beside it."""
    nr.save_mesh(folder / "m.glb", *nr.icosphere(0), torch.rand(20, 2, 2, 2, 3))
    files = trimesh.exchange.gltf.export_gltf(trimesh.load(folder / "m.glb"))
    tree = json.loads(files.pop("model.gltf"))
    tree["images"] = [{"uri": image}]
    for name, content in files.items():
        (folder / "home" / name).write_bytes(content)
    path = folder / "home" / "m.gltf"
    path.write_text(json.dumps(tree))
    return path


def color(path: Path, **options: bool) -> list[float]:
    """The one colour of a mesh, as both ways to load it see it."""
    textures = nr.load_mesh(path, 2, **options)[2]
    assert textures is not None
    [baked] = textures.reshape(-1, 3).unique(dim=0)
    loaded = nr.UVMesh.load(path, **options)
    texels = loaded.images[0] if loaded.images else loaded.colors
    assert torch.equal(texels.reshape(-1, 3).unique(dim=0), baked[None])
    return baked.tolist()


@pytest.mark.parametrize("write", [obj, gltf])
def test_a_sibling_folder_is_read_only_if_asked_for(folder: Path, write) -> None:
    path = write(folder, "../beside/red.png")
    for load in (lambda: nr.load_mesh(path, 2), lambda: nr.UVMesh.load(path), lambda: nr.Mesh.load(path)):
        with pytest.raises(ValueError, match=rf"{path.name}: expected .* got '../beside/red.png', {HINT}"):
            load()
    assert color(path, allow_outside=True) == [1, 0, 0]
    assert color(write(folder, "inner/../inner/green.png")) == [0, 1, 0]


def test_the_drop_in_functions(folder: Path) -> None:
    path = obj(folder, "../beside/red.png")
    with pytest.raises(ValueError, match=HINT):
        nr.load_obj(path, load_texture=True)
    with pytest.raises(ValueError, match=HINT):
        nr.Mesh.fromobj(path, load_texture=True)
    assert len(nr.load_obj(path)) == 2  # without colours nothing else is read
    assert (nr.load_obj(path, load_texture=True, allow_outside=True)[2][..., 0] == 1).all()
    assert (nr.Mesh.fromobj(path, load_texture=True, allow_outside=True).textures[..., 0] == 1).all()


def test_the_command(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["render", str(obj(folder, "../beside/red.png")), "-o", str(folder / "a.png"), "--size", "16"]
    assert cli.main(arguments) == 1
    assert "--allow-outside" in capsys.readouterr().err
    assert cli.main([*arguments, "--allow-outside"]) == 0
    assert nr.load_image(folder / "a.png")[..., 0].min() > 0.2


def test_materials_may_lie_below_and_name_what_lies_above_them(folder: Path) -> None:
    """Names are relative to the folder of the mesh, not to the folder of its materials."""
    assert color(obj(folder, "../inner/green.png", "materials/m.mtl")) == [0, 1, 0]
    with pytest.raises(ValueError, match=HINT):
        nr.load_mesh(obj(folder, "../../beside/red.png", "materials/m.mtl"))
    path = obj(folder, "../beside/red.png", "../beside/m.mtl")
    with pytest.raises(ValueError, match=rf"'../beside/m.mtl', {HINT}"):
        nr.load_mesh(path)
    assert color(path, allow_outside=True) == [1, 0, 0]


@pytest.mark.parametrize("exists", [True, False])
def test_an_absolute_path_is_no_file_of_the_folder(folder: Path, exists: bool) -> None:
    """Nor does anyone learn whether it exists; its last part may lie beside the mesh."""
    target = folder / "beside" / "red.png"
    path = obj(folder, str(target))
    if not exists:
        target.unlink()
    with pytest.warns(UserWarning, match=r"is missing in its folder; allow_outside=True"):
        assert (nr.load_mesh(path, 2)[2] == 0.5).all()
    if exists:
        assert color(path, allow_outside=True) == [1, 0, 0]
    shutil.copy(folder / "home" / "inner" / "green.png", folder / "home" / "red.png")
    assert color(path) == [0, 1, 0]
    assert color(obj(folder, str(folder / "home" / "inner" / "green.png"))) == [0, 1, 0]


def test_no_error_tells_what_lies_elsewhere(folder: Path) -> None:
    messages = []
    for name in ("../beside/red.png", "../beside/not.png"):
        with pytest.raises(ValueError) as error:
            nr.load_mesh(obj(folder, name))
        messages.append(str(error.value).replace(name, ""))
    assert messages[0] == messages[1]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no pipes")
@pytest.mark.parametrize("name", ["pipe.png", "/dev/zero", "/proc/kmsg"])
def test_devices_and_pipes_are_never_read(folder: Path, name: str) -> None:
    """A reader would wait, or never end; this test, too."""
    os.mkfifo(folder / "home" / "pipe.png")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for path in (obj(folder, name), gltf(folder, name)):
            try:
                textures = nr.load_mesh(path, 2, allow_outside=True)[2]
                assert textures is None or len(textures.unique()) == 1
            except ValueError as error:
                assert "expected a picture, got an empty file" in str(error)
        path = obj(folder, "x.png")
        path.write_text(path.read_text().replace("mtllib m.mtl", f"mtllib {name}"))
        assert (nr.load_mesh(path, 2, allow_outside=True)[2] == 0.5).all()


def test_many_missing_files_list_a_folder_once_and_are_counted(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    listed, names = [], os.listdir
    monkeypatch.setattr(os, "listdir", lambda place: (listed.append(place), names(place))[1])
    path, numbers = obj(folder, "x.png"), range(30)
    library = "".join(f"newmtl m{number}\nmap_Kd a{number}.png\n" for number in numbers)
    path.with_name("m.mtl").write_text(library)
    lines = [line for line in path.read_text().split("\n") if line.startswith(("v", "f"))]
    triangle, face = "\n".join(lines[:-1]), lines[-1]
    uses = "".join(f"usemtl m{number}\n{face}\n" for number in numbers)
    missing = " ".join(f"b{number}.mtl" for number in numbers)
    path.write_text(f"mtllib m.mtl {missing}\n{triangle}\n{uses}")
    with pytest.warns(UserWarning) as said:
        nr.UVMesh.load(path)
    assert len(listed) == 2 and len(said) == 22  # one for material files, one for images
    text = " ".join(str(warning.message) for warning in said)
    assert "20 more of its material files are missing" in text and "20 more of its images are missing" in text


def test_missing_images_of_gltf_are_named(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.warns(UserWarning, match=r"m\.gltf: its file 'a%20b\.png' is missing"):
        assert (nr.load_mesh(gltf(folder, "a%20b.png"), 2)[2] == 1).all()
    shutil.copy(folder / "beside" / "red.png", folder / "home" / "a b.png")
    assert color(folder / "home" / "m.gltf") == [1, 0, 0]
    ply = folder / "home" / "m.ply"
    vertices = "element vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    faces = "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    ply.write_text(f"ply\nformat ascii 1.0\ncomment TextureFile none.png\n{vertices}{faces}")
    with pytest.warns(UserWarning, match=r"m\.ply: its file 'none\.png' is missing"):
        nr.load_mesh(ply, 2)
    assert capfd.readouterr().err == ""


def test_names(tmp_path: Path) -> None:
    source = tmp_path / "home" / "a.obj"
    source.parent.mkdir()
    (tmp_path / "home" / "b.mtl").write_text("")
    for name, out in {
        "b.mtl": False,
        "./x/../b.mtl": False,
        "../home/b.mtl": False,
        "..": True,
        "x/../../b.mtl": True,
        "../homely/b.mtl": True,
        "/b.mtl": True,
        str(source.parent / "b.mtl"): False,
    }.items():
        assert is_outside(source, name) == out, name
    assert find_file(source, "..\\home\\B.MTL") == source.parent / "b.mtl"
    for name in ("", "x" * 5000, "x\0y", "b.mtl/c", "."):  # no such name may reach the system
        assert find_file(source, name, allow_outside=True) is None, name


def test_reasons_are_cut():
    """Damaged checkpoints put their bytes into torch's message."""
    assert len(why_not_loaded(RuntimeError("Unknown endianness type: " + 5000 * "x"))) < 300
