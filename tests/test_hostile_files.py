"""Damaged files of every kind that is read: their content, or a ValueError or OSError that names one of them.

Each file is changed at random by hypothesis. A reader may neither crash, hang nor fill the memory: for files of some
kilobytes it has a minute, and two gigabytes more than the process had. The long run, over thousands of files and the
nasty ones of other projects, has the marker `slow`.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

import neural_renderer as nr
from neural_renderer.apps.common.features import load_features
from neural_renderer.apps.common.task_runner import TaskRunner
from neural_renderer.apps.fit import load_views
from neural_renderer.apps.reconstruct.data.arrays import open_split
from neural_renderer.apps.reconstruct.data.models_folder import read_splits
from neural_renderer.apps.reconstruct.networks.checkpoint import load_model, make_network, save_model
from tests.apps.edit.networks import vgg_weights
from tests.apps.reconstruct.synthetic import SMALL
from tests.mutations import archive, damage, glb, plain, png

SECONDS, GIGABYTES = 60, 2
LATE = f"still reading after {SECONDS} s"
QUICK, LONG = 15, 1500  # files of each kind
MESHES = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")


@dataclass(frozen=True)
class Kind:
    """A kind of file: how good ones are written to a folder, which of them is changed and how, and how it is read."""

    write: Callable[[Path], list[str]]
    read: Callable[[Path], None]
    containers: tuple[Any, ...] = (plain,)


def sphere() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    vertices, faces = nr.icosphere(0)
    return vertices, faces, (vertices[faces.long()].mean(1) * 0.5 + 0.5)[:, None, None, None].expand(-1, 2, 2, 2, -1)


def write_obj(folder: Path) -> list[str]:
    nr.save_mesh(folder / "m.obj", *sphere())
    text = "v 0 0 0 1 0 0\nv 1 0 0\nv 1 1 0\nv 0.2 0.1 0\nv 0 1 0\nvt 0 0 0\nvt 1 -2.5\nvn 0 0 1\ng a\ns 1\nusemtl b\n"
    (folder / "n.obj").write_text(f"mtllib m.mtl n.mtl\n{text}f 1/1/1 2/2/1 \\\n 3/1 4/2 5/-1\nf 1//1 2 -1\nl 1 2\n")
    maps = "map_Kd -clamp on -s 2 2 1 -o 0.5 -bm 1 n.png -mm 0 1"
    (folder / "n.mtl").write_text(f"# made by hand\nnewmtl b\nKa 0 0 0\nKd 0.5 0.25 1\n{maps}\nnewmtl c\nKd 1\n")
    nr.save_image(folder / "n.png", torch.rand(5, 4, 3))
    shiny().save(folder / "o.obj")
    return ["m.obj", "n.obj", "o.obj", "m.mtl", "n.mtl", "o.mtl"]


def shiny() -> nr.UVMesh:
    """A mesh with all that a glTF material can have."""
    corners = torch.tensor([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    picture = nr.Texture(torch.rand(2, 3, 3), wrap=("clamp", "mirror"), offset=(0.5, 0.0), rotation=0.5)
    alpha = nr.Texture(torch.rand(2, 3, 1))
    textures = {f"{name}_texture": picture for name in ("emissive", "normal", "occlusion", "metallic_roughness")}
    material = nr.Material("m", alpha_mode="BLEND", opacity_texture=alpha, emissive=(2.0, 1.0, 0.0), **textures)
    geometry = torch.nn.functional.pad(corners, (0, 1)), torch.tensor([[0, 1, 2]]), corners
    directions = {"normals": torch.tensor([[[0.0, 0.0, 1.0]] * 3]), "tangents": torch.tensor([[[1.0, 0, 0, 1]] * 3])}
    return nr.UVMesh(*geometry, torch.rand(2, 3, 3), materials=(material,), uv1=corners[None], **directions)


def write_mesh(suffix: str) -> Callable[[Path], list[str]]:
    def write(folder: Path) -> list[str]:
        vertices, faces, textures = sphere()
        if suffix in (".glb", ".gltf"):
            nr.save_mesh(folder / "m.glb", vertices, faces, textures)
            shiny().save(folder / "n.glb")
            if suffix == ".glb":
                return ["m.glb", "n.glb"]
            data = (folder / "n.glb").read_bytes()
            end = 20 + int.from_bytes(data[12:16], "little")
            tree = json.loads(data[20:end])
            tree["buffers"][0]["uri"] = "n.bin"
            (folder / "n.gltf").write_text(json.dumps(tree))
            (folder / "n.bin").write_bytes(data[end + 8 :])
            (folder / "n.glb").unlink()
            for name, content in trimesh.exchange.gltf.export_gltf(trimesh.load(folder / "m.glb")).items():
                (folder / name.replace("model", "m")).write_bytes(content)
            (folder / "m.glb").unlink()
            return ["m.gltf", "gltf_buffer_0.bin", "n.gltf", "n.bin"]
        mesh = trimesh.Trimesh(vertices.numpy(), faces.numpy(), process=False, vertex_colors=[[9, 99, 200, 255]] * 12)
        mesh.export(folder / f"m{suffix}")
        texts = {".ply": {"encoding": "ascii"}, ".stl": {"file_type": "stl_ascii"}}
        if suffix in texts:
            (folder / f"n{suffix}").write_bytes(_bytes(mesh.export(**{"file_type": suffix[1:]} | texts[suffix])))
        return [f"{name}{suffix}" for name in ("m", "n") if (folder / f"{name}{suffix}").exists()]

    return write


def _bytes(content: str | bytes) -> bytes:
    return content.encode() if isinstance(content, str) else content


def read_meshes(folder: Path) -> None:
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() in MESHES:
            read_mesh(path)


def read_mesh(path: Path) -> None:
    """By both ways."""
    vertices, faces, textures = nr.load_mesh(path, 2)
    assert vertices.dtype == torch.float32 and bool(vertices.isfinite().all())
    assert len(faces) and int(faces.min()) >= 0 and int(faces.max()) < len(vertices)
    assert textures is None or (textures.shape == (len(faces), 2, 2, 2, 3) and in_range(textures))
    mesh = nr.UVMesh.load(path)
    mesh._check(always=True)
    assert torch.equal(mesh.vertices, vertices) and torch.equal(mesh.faces, faces)
    assert all(in_range(image) for image in (*mesh.images, mesh.colors))


def in_range(image: torch.Tensor) -> bool:
    """All numbers are in [0, 1], up to rounding of means."""
    return bool(((image >= -1e-6) & (image <= 1 + 1e-6)).all())


def write_pictures(suffix: str) -> Callable[[Path], list[str]]:
    def write(folder: Path) -> list[str]:
        pixels = (torch.rand(6, 5, 4) * 255).byte().numpy()
        modes = ["RGB", "L", "RGBA", "P", "1", "I;16"] if suffix == ".png" else ["RGB", "L", "CMYK"]
        for mode in modes:
            image = Image.fromarray(pixels[..., 0].astype(np.uint16) * 257 if mode == "I;16" else pixels)
            image = image if mode == "I;16" else image.convert("RGB" if mode in "CMYK" else "RGBA").convert(mode)
            image.save(folder / f"{mode.replace(';', '')}{suffix}")
        return [path.name for path in folder.iterdir()]

    return write


def read_pictures(folder: Path) -> None:
    for path in sorted(folder.iterdir()):
        image = nr.load_image(path, upright=True)
        assert image.dtype == torch.float32 and image.shape[2] in (3, 4) and in_range(image)


def write_views(folder: Path) -> list[str]:
    for index in range(2):
        image = torch.rand(16, 16, 4)
        image[4:12, 4:12, 3] = 1
        nr.save_image(folder / f"{index}.png", image)
    pose = [[1.0, 0, 0, 0.5], [0, 0, -1, 2], [0, 1, 0, 0.25], [0, 0, 0, 1]]
    frames = [{"file_path": f"./{index}.png", "transform_matrix": pose, "cx": 8.0} for index in range(2)]
    nerf = {"camera_angle_x": 0.8, "w": 16, "h": 16.0, "k1": 0.01, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(nerf))
    views = [{"file": f"{index}.png", "azimuth": 10 * index, "elevation": 20, "distance": 2.7} for index in range(2)]
    (folder / "cameras.json").write_text(json.dumps({"viewing_angle": 30, "views": views}))
    rows = "file,azimuth,elevation,distance,viewing_angle,mask\n0.png,0,30,2.7,30,1.png\n1.png, 10.5,-3e1,3,25,\n"
    (folder / "cameras.csv").write_text(rows)
    return ["transforms.json", "cameras.json", "cameras.csv"]


def read_views(folder: Path) -> None:
    for name in ("transforms.json", "cameras.json", "cameras.csv"):
        views = load_views(folder / name)
        assert views.masks.ndim == 3 and in_range(views.masks) and views.photos is not None and in_range(views.photos)


def write_data(folder: Path) -> list[str]:
    images = np.zeros((1, 24, 4, 64, 64), np.uint8)
    images[:, :, :, 20:40, 20:40] = 200
    np.savez_compressed(folder / "chair_test_images.npz", images)
    np.savez(folder / "chair_test_voxels.npz", np.ones((1, 32, 32, 32), bool))
    (folder / "dataset.json").write_text(json.dumps({"names": {"test": {"chair": ["a"]}}}))
    (folder / "splits.csv").write_text("category,model,split\nchair,a,test\nchair,b,valid\n")
    open_split(folder, "test")  # unpacks them
    return [path.name for path in folder.iterdir()]


def read_data(folder: Path) -> None:
    """An unpacked copy is read; a wrong copy is made again."""
    split = open_split(folder, "test")
    assert split.images["chair"].shape[1:] == (24, 4, 64, 64) and split.images["chair"].dtype == np.uint8
    assert split.voxels["chair"].shape[1:] == (32, 32, 32)
    assert all(isinstance(name, str) for pair in read_splits(folder / "splits.csv") for name in pair)


def write_weights(folder: Path) -> list[str]:
    network = make_network("mesh", SMALL)
    save_model(folder / "best.ckpt", network, ["chair"])
    torch.save(vgg_weights(2), folder / "vgg.pth")
    state = {"task": {"step": 3}, "history": [{"loss": 1.0}], "seconds": 1.5, "inputs": {"steps": 3}}
    torch.save(state, folder / "checkpoint.pt")
    return ["best.ckpt", "vgg.pth", "checkpoint.pt"]


def read_weights(folder: Path) -> None:
    load_model(folder / "best.ckpt")
    load_features(folder / "vgg.pth")
    run = TaskRunner(folder, FakeTask(), {"steps": 3}, lambda path: None)
    run._restore()


class FakeTask:
    """Task that resumes from any state."""

    phase, step, steps, done = "shape", 3, 3, True

    def load_state_dict(self, state: dict[str, Any]) -> None: ...


KINDS = {
    "obj": Kind(write_obj, read_meshes),
    "ply": Kind(write_mesh(".ply"), read_meshes),
    "stl": Kind(write_mesh(".stl"), read_meshes),
    "off": Kind(write_mesh(".off"), read_meshes),
    "glb": Kind(write_mesh(".glb"), read_meshes, (plain, glb)),
    "gltf": Kind(write_mesh(".gltf"), read_meshes),
    "png": Kind(write_pictures(".png"), read_pictures, (plain, png)),
    "jpg": Kind(write_pictures(".jpg"), read_pictures),
    "views": Kind(write_views, read_views),
    "data": Kind(write_data, read_data, (plain, archive)),
    "weights": Kind(write_weights, read_weights, (plain, archive)),
}


@contextmanager
def bounded() -> Iterator[None]:
    """An error where something hangs or takes far more memory than such files need (where the system can tell)."""
    if sys.platform != "linux":
        yield
        return
    import resource

    def late(*_: object) -> None:
        raise TimeoutError(LATE)

    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    handler = signal.signal(signal.SIGALRM, late)
    resource.setrlimit(resource.RLIMIT_AS, (used + (GIGABYTES << 30), before[1]))
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, handler)
        resource.setrlimit(resource.RLIMIT_AS, before)


def check(path: Path, change: Callable[[bytes], bytes], read: Callable[[], None]) -> None:
    """Read with ``path`` changed: it works, or the error names a file of the folder."""
    data, status = path.read_bytes(), path.stat()
    path.write_bytes(change(data))
    if path.suffix == ".npy":  # still taken for the copy of its npz
        os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))
    try:
        with bounded(), warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            read()
    except TimeoutError:
        raise
    except (ValueError, OSError) as error:
        message = str(error)
        assert any(file.name in message for file in path.parent.iterdir()), message
        assert len(message) < 1000, message
        assert not any(word in message for word in (LATE, "MemoryError", "llocate")), message
    finally:
        path.write_bytes(data)


@pytest.fixture(scope="session")
def good(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], tuple[Path, list[str]]]:
    """A folder of good files of a kind, and the names of those that are changed."""
    known: dict[str, tuple[Path, list[str]]] = {}

    def folder(name: str) -> tuple[Path, list[str]]:
        if name not in known:
            made = tmp_path_factory.mktemp(name)
            torch.manual_seed(0)
            known[name] = made, KINDS[name].write(made)
            KINDS[name].read(made)
        return known[name]

    return folder


def hostile(good: Any, name: str, count: int, derandomize: bool) -> None:
    folder, names = good(name)

    @settings(
        max_examples=count, derandomize=derandomize, deadline=None, database=None, suppress_health_check=HealthCheck
    )
    @given(st.sampled_from(names), damage(KINDS[name].containers))
    def run(file: str, change: Callable[[bytes], bytes]) -> None:
        check(folder / file, change, lambda: KINDS[name].read(folder))

    run()


@pytest.mark.parametrize("name", KINDS)
def test_some_damaged_files(good: Any, name: str) -> None:
    hostile(good, name, QUICK, derandomize=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_many_damaged_files(good: Any, name: str) -> None:
    hostile(good, name, LONG, derandomize=False)


@pytest.mark.slow
def test_damaged_files_of_others(shared: Path, tmp_path: Path) -> None:
    """Those that are nasty already."""
    shutil.copytree(shared / "data" / "meshes" / "nasty", tmp_path / "nasty")
    found = sorted(path for path in (tmp_path / "nasty").rglob("*") if path.suffix.lower() in MESHES)
    found = [path for path in found if path.stat().st_size < 50_000]
    assert len(found) > 90

    @settings(max_examples=2 * LONG, deadline=None, database=None, suppress_health_check=HealthCheck)
    @given(st.sampled_from(found), damage([plain]))
    def run(path: Path, change: Callable[[bytes], bytes]) -> None:
        check(path, change, lambda: read_mesh(path))

    run()
