"""Kinds of files for fuzzers: those of `tests.test_hostile_files`, and more."""

from __future__ import annotations

import io
import json
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from PIL import Image

import neural_renderer as nr
from neural_renderer.apps.common.views.maps import read_depth, read_normals
from neural_renderer.apps.fit.photos.video import choose_frames
from neural_renderer.apps.many.models import list_models, opened
from neural_renderer.apps.view.drawing.snapshot import take_snapshot
from neural_renderer.apps.view.records.recorder import BEGIN, END, Recorder
from neural_renderer.apps.view.records.replay import Record
from neural_renderer.apps.view.results import read_results
from neural_renderer.camera.files.load import load_cameras
from neural_renderer.io.image_formats.pictures import FORMATS
from neural_renderer.io.image_formats.radiance import radiance_bytes
from tests.gltf.test_compressed import basis, draco, ktx2, meshopt, saved
from tests.mutations import archive, glb, plain, png
from tests.test_hostile_files import KINDS, Kind, in_range, read_meshes, shiny

BALL = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def write_pictures(folder: Path) -> list[str]:
    pixels = Image.fromarray((torch.rand(9, 7, 3) * 255).byte().numpy())
    for name in FORMATS:
        pixels.save(folder / f"{name}.x", name)
    return [f"{name}.x" for name in FORMATS]


def read_pictures(folder: Path) -> None:
    for path in sorted(folder.iterdir()):
        image = nr.load_image(path, upright=True)
        assert image.dtype == torch.float32 and image.shape[2] in (3, 4) and in_range(image)


def write_surroundings(folder: Path) -> list[str]:
    (folder / "a.hdr").write_bytes(radiance_bytes(np.random.default_rng(0).random((4, 6, 3), np.float32)))
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=2\n\n+Y 2 -X 9\n"
    (folder / "b.hdr").write_bytes(head + b"\2\2\0\x09" + b"\x89\1" * 4 + b"\2\2\0\x09" + b"\x84\1\5abcde" * 4)
    nr.save_image(folder / "c.exr", torch.rand(5, 4, 3) * 3)
    return ["a.hdr", "b.hdr", "c.exr"]


def read_surroundings(folder: Path) -> None:
    for path in sorted(folder.iterdir()):
        image = torch.as_tensor(nr.EnvironmentLight.load(path).image)
        assert image.dtype == torch.float32 and image.shape[2] == 3


def rig() -> nr.Rig:
    """A rig with joints, a morph target and an animation of each kind."""
    from neural_renderer.io.gltf.rig_reader import Track

    vertices, faces = nr.icosphere(0)
    mesh = nr.UVMesh(vertices, faces, torch.zeros(faces.shape[0], 3, 2), torch.rand(1, 1, 3))
    weights = torch.rand(12, 2, generator=torch.Generator().manual_seed(0)) + 0.1
    times = np.array([0.0, 1.0])
    spins = np.array([[0.0, 0, 0, 1], [0.0, 1, 0, 0]])
    tracks = [Track(1, "rotation", times, spins), Track(0, "translation", times, np.eye(3)[:2], "STEP")]
    tracks.append(Track(0, "weights", times, np.zeros((2, 3, 1)), "CUBICSPLINE"))
    return nr.Rig(
        mesh,
        [-1, 0],
        torch.rand(2, 3),
        weights / weights.sum(1, keepdim=True),
        targets=torch.rand(1, 12, 3),
        target_weights=torch.ones(1),
        animations={"go": tracks},
    )


def write_rigs(folder: Path) -> list[str]:
    rig().save(folder / "r.glb")
    return ["r.glb"]


def read_rigs(folder: Path) -> None:
    try:
        loaded = nr.Rig.load(folder / "r.glb")
        names = list(loaded.animations or {})
        for name in names[:4]:
            loaded.vertices(loaded.animated([0.0, 0.5, 9.0], name))
    except ValueError as error:
        raise ValueError(f"r.glb: {error}") from None  # an animation that is not there has no file
    assert bool(loaded.vertices().isfinite().all())


def write_archives(folder: Path) -> list[str]:
    with zipfile.ZipFile(folder / "a.zip", "w", zipfile.ZIP_DEFLATED) as pack:
        pack.writestr("in/a.obj", "mtllib a.mtl\n" + BALL)
        pack.writestr("in/a.mtl", "newmtl a\nKd 1 0 0\n")
    for name, mode in (("b.tar", "w"), ("c.tar.gz", "w:gz")):
        with tarfile.open(folder / name, mode) as tar:
            for member in ("in/b.obj", "long" * 60 + ".obj"):
                info = tarfile.TarInfo(member)
                info.size, info.pax_headers = len(BALL), {"comment": "x"}
                tar.addfile(info, io.BytesIO(BALL.encode()))
            link = tarfile.TarInfo("link.obj")
            link.type, link.linkname = tarfile.SYMTYPE, "in/b.obj"
            tar.addfile(link)
    return ["a.zip", "b.tar", "c.tar.gz"]


def read_archives(folder: Path) -> None:
    for model in list_models([folder]):
        with opened(model) as path:
            assert path.stat().st_size < 1 << 20 and path.is_file()


def write_lists(folder: Path) -> list[str]:
    (folder / "a.obj").write_text(BALL)
    (folder / "l.txt").write_text("a.obj\n\nb.zip\n")
    (folder / "l.csv").write_text('path,name,member\na.obj,chair,\n"a.obj","x, y",\nb.zip,z,a.obj\n')
    with zipfile.ZipFile(folder / "b.zip", "w") as pack:
        pack.writestr("a.obj", BALL)
    return ["l.txt", "l.csv"]


def record_part(data: bytes, part: float, change: Callable[[bytes], bytes]) -> bytes:
    """Inside of the JSON of a record."""
    begin = data.index(BEGIN.encode()) + len(BEGIN)
    end = data.index(END.encode(), begin)
    return data[:begin] + change(data[begin:end]) + data[end:]


def inside(data: bytes, part: float, change: Callable[[bytes], bytes]) -> bytes:
    """Anywhere, but for paths that lead out: a list is its user's own, and may name any folder, even the whole disk."""
    return change(data).replace(b"/", b"_").replace(b"..", b"_").replace(b"\\", b"_")


def read_lists(folder: Path) -> None:
    for name in ("l.txt", "l.csv"):
        found = [model.name for model in list_models([folder / name])]
        assert found == sorted(set(found)) and all(len(part) < 240 for one in found for part in one.split("/"))


def write_videos(folder: Path) -> list[str]:
    nr.save_animation(folder / "v.mp4", torch.rand(4, 3, 16, 16, generator=torch.Generator().manual_seed(0)))
    return ["v.mp4"]


def read_videos(folder: Path) -> None:
    for *_, frame in choose_frames(folder / "v.mp4", 2, 16):
        assert frame.ndim == 3 and max(frame.shape[:2]) <= 16


def write_results(folder: Path) -> list[str]:
    nr.Mesh.icosphere(0).save(folder / "mesh.obj")
    inputs = {"mesh": "mesh.obj", "images": "x.png", "background": [0, 0, 0], "photos": True}
    report = {"inputs": inputs, "history": [{"loss": 1.0, "iou": 0.5}, {"loss": 0.5}], "finished": True}
    (folder / "report.json").write_text(json.dumps(report))
    (folder / "log.csv").write_text("step,loss,iou\n1,0.5,0.25\n2,0.25,\n")
    return ["report.json", "log.csv"]


def read_folder(folder: Path) -> None:
    results = read_results(folder)
    assert all(len(points) < 1000 for points in results.numbers.values())


def write_cameras(folder: Path) -> list[str]:
    nr.save_image(folder / "0.png", torch.rand(16, 16, 3))
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    lenses = "1 SIMPLE_RADIAL 16 16 20 8 8 0.01\n2 OPENCV 16 16 20 20 8 8 0 0 0 0\n"
    (model / "cameras.txt").write_text(f"# cameras\n{lenses}")
    (model / "images.txt").write_text("1 1 0 0 0 0 0 3 1 0.png\n\n2 0.9 0.1 0 0 0 0 3 2 0.png\n1.5 2.5 -1\n")
    (model / "points3D.txt").write_text("1 0 0 0 9 9 9 0.5 1 0\n")
    return ["sparse/0/cameras.txt", "sparse/0/images.txt"]


def read_cameras(folder: Path) -> None:
    cameras = load_cameras(folder / "sparse" / "0", (16, 16))[0]
    assert bool(cameras.rotation.isfinite().all())


def write_records(folder: Path) -> list[str]:
    recorder = Recorder(folder / "run.html")
    for step in range(2):
        recorder.add(step, {"ball": take_snapshot(shiny()), "other": take_snapshot(nr.Mesh.icosphere(0))})
    recorder.write()
    return ["run.html"]


def read_records(folder: Path) -> None:
    record = Record(folder / "run.html")
    for number in range(min(len(record), 4)):
        for snapshot in record.meshes(number).values():
            assert snapshot.faces.shape[1] == 3


def write_compressed(folder: Path) -> list[str]:
    draco().save(folder / "draco.glb")
    saved(meshopt(), folder / "meshopt.gltf")
    basis(ktx2((255, 128, 0))).save(folder / "basis.glb")
    return ["draco.glb", "data.bin", "meshopt.gltf", "basis.glb"]


def write_arrays(folder: Path) -> list[str]:
    matrix = np.array([[20.0, 0, 8, 0], [0, 20, 8, 0], [0, 0, 1, 3], [0, 0, 0, 1]])
    np.savez_compressed(folder / "cameras.npz", world_mat_0=matrix, scale_mat_0=np.eye(4), world_mat_1=matrix[:3])
    np.save(folder / "depth.npy", np.ones((6, 8), np.float32))
    np.save(folder / "normals.npy", np.ones((6, 8, 3)))
    Image.fromarray(np.full((6, 8), 9000, np.uint16)).save(folder / "depth.png")
    return ["cameras.npz", "depth.npy", "normals.npy", "depth.png"]


def read_arrays(folder: Path) -> None:
    cameras = load_cameras(folder / "cameras.npz", (16, 16))[0]
    assert bool(cameras.rotation.isfinite().all())
    depths = [read_depth(folder / name, (6, 8), 1000.0) for name in ("depth.npy", "depth.png")]
    assert all(bool((depth >= 0).all()) for depth in depths)
    assert bool(read_normals(folder / "normals.npy", (6, 8)).isfinite().all())


MORE = {
    "pictures": Kind(write_pictures, read_pictures),
    "surroundings": Kind(write_surroundings, read_surroundings),
    "rigs": Kind(write_rigs, read_rigs, (plain, glb)),
    "archives": Kind(write_archives, read_archives, (plain, archive)),
    "lists": Kind(write_lists, read_lists, (inside,)),
    "videos": Kind(write_videos, read_videos),
    "results": Kind(write_results, read_folder),
    "colmap": Kind(write_cameras, read_cameras),
    "records": Kind(write_records, read_records, (plain, record_part)),
    "compressed": Kind(write_compressed, read_meshes, (plain, glb)),
    "arrays": Kind(write_arrays, read_arrays, (plain, archive, png)),
}
FILES = KINDS | MORE
