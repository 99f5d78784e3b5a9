"""Table of the glTF files of a folder: what the package reads, beside the independent reader of `reference`.

    python -m tests.gltf.compare FOLDER … [--all]

For each file: the bounds, the number of faces, and the colour of each pixel in two views, without light. "wrong" has to
be 0. Files that are refused are listed with their sentences, since a person has to judge these.
"""

from __future__ import annotations

import argparse
import json
import re
import signal
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch

import neural_renderer as nr
from tests.gltf import reference

SIDE, FINE = 40, 3  # pixels of a view, and samples of the reference in each direction of a pixel
MOST_FACES = 20_000  # larger files are compared by bounds and faces alone
TOLERANCE = 0.02
MANY = 99  # pixels
LEVELS = 12  # sizes of a picture
VIEWS = (np.eye(3), np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]]))
PYTHON = re.compile(
    r"object has no attribute|out of range|unexpected keyword|NoneType|not subscriptable|KeyError|unpack"
)


def compare(path: Path) -> tuple[str, str]:
    """Read a file both ways: "right", "refused", "both refuse", "unknown" or "wrong", and why."""
    try:
        known = reference.Scene(path)
        sane = np.isfinite(known.triangles.astype(np.float32)).all()
        problem = "" if sane and len(known.triangles) else "no faces"
    except Exception as error:
        known, problem = None, f"{type(error).__name__}: {error}"
    said: list[str] = []
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            mesh = nr.UVMesh.load(path)
            mesh._check(always=True)
        said = [str(one.message).rpartition(f"{path}: ")[2] for one in caught]
    except (ValueError, OSError) as error:
        sentence = str(error).replace(str(path), path.name)
        if PYTHON.search(sentence):
            return "wrong", f"Python's words: {sentence}"
        return ("refused" if not problem else "both refuse"), sentence
    except Exception as error:
        return "wrong", f"raised {type(error).__name__}: {error}"
    if known is None or problem:
        return "unknown", f"read here, not by the reference ({problem[:100]}); {'; '.join(said)}"
    triangles, scale = known.triangles, max(float(np.abs(known.triangles).max()), 1e-30)
    if len(mesh.faces) != len(triangles):
        return "wrong", f"{len(mesh.faces)} faces, not {len(triangles)}"
    own = mesh.vertices[mesh.faces.long()].double().numpy()
    own_bounds, bounds = (np.concatenate((t.min((0, 1)), t.max((0, 1)))) for t in (own, triangles))
    if np.abs(own_bounds - bounds).max() > 1e-5 * scale:
        return "wrong", f"bounds {own_bounds.round(4).tolist()}, not {bounds.round(4).tolist()}"
    if len(triangles) > MOST_FACES:
        return "right", f"bounds and faces alone ({len(triangles)} faces)"
    off, count = 0, 0
    for view in VIEWS:
        bad, seen = different_pixels(mesh, known, view)
        off, count = off + bad, count + seen
    if off > max(2, 0.01 * count):
        return "wrong", f"{off} of {count} pixels have other colours"
    return "right", f"{count} pixels; {'; '.join(said)}"


def different_pixels(mesh: nr.UVMesh, known: reference.Scene, view: np.ndarray) -> tuple[int, int]:
    """Draw both from a side, without light: how many pixels differ, and how many were compared."""
    triangles = known.triangles
    low, high = triangles.min((0, 1)), triangles.max((0, 1))
    center, size = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-30)
    points = (mesh.vertices.double().numpy() - center) / size @ view.T
    pose = torch.eye(4)
    pose[2, 3] = 3.0
    camera = nr.Camera.from_matrix(camera_to_world=pose, convention="opengl", orthographic=True)
    seen = mesh.replace(vertices=torch.from_numpy(0.95 * points).float())
    images = nr.render(seen, camera, SIDE, light=None, anti_aliasing=False, outputs=("rgb", "alpha"))
    ours, alpha = images.rgb[0].movedim(0, 2).numpy(), images.alpha[0].numpy()
    shown = (triangles - center) / size @ view.T * 0.95
    face, weights, clear = draw(shown)
    whole = clear.reshape(SIDE, FINE, SIDE, FINE).all((1, 3)) & (alpha > 0)
    inner = all_around(np.pad(whole, 1)).all(2)
    reach = inner.sum() > MANY  # the filter of mipmaps reaches into the pixels around
    whole = inner if reach else whole
    low, high = np.full((SIDE, SIDE, 3), np.inf), np.full((SIDE, SIDE, 3), -np.inf)
    for drawn in colorings(known, face, weights, shown):
        blocks = drawn.reshape(SIDE, FINE, SIDE, FINE, 3).swapaxes(1, 2).reshape(SIDE, SIDE, -1, 3)
        if reach:
            blocks = all_around(np.pad(blocks, ((1, 1), (1, 1), (0, 0), (0, 0)))).reshape(SIDE, SIDE, -1, 3)
        low, high = np.minimum(low, blocks.min(2)), np.maximum(high, blocks.max(2))
    bad = ((ours < low - TOLERANCE) | (ours > high + TOLERANCE)).any(2)
    return int((bad & whole).sum()), int(whole.sum())


def all_around(values: np.ndarray) -> np.ndarray:
    """Collect the values of each pixel and of the eight around it, [H, W, 9, ...], of an image with a border."""
    return np.stack([values[y : y + SIDE, x : x + SIDE] for y in range(3) for x in range(3)], 2)


def colorings(known: reference.Scene, face: np.ndarray, weights: np.ndarray, shown: np.ndarray) -> Iterator[np.ndarray]:
    """Colour a drawing with each picture as it is, then halved again and again, as long as a pixel covers two texels.

    Filters of mipmaps blend between these. ``shown`` [F, 3, 3] are the triangles as `draw` takes them.
    """
    texels = np.concatenate([footprints(part, own) for part, own in zip(known.parts, split(known, shown), strict=True)])
    colors = np.zeros((*face.shape, 3))
    for level in range(LEVELS):
        start = 0
        for part in known.parts:
            end = start + len(part.corners)
            own = (face >= start) & (face < end) & (2 * texels[face] >= 2**level if level else face >= 0)
            if own.any():
                colors[own] = reference.color_at(part, face[own] - start, weights[own], 2**level)[:, :3]
            start = end
        yield colors


def split(known: reference.Scene, values: np.ndarray) -> list[np.ndarray]:
    """Split values of all triangles into those of each part."""
    return np.split(values, np.cumsum([len(part.corners) for part in known.parts])[:-1])


def footprints(part: reference.Triangles, shown: np.ndarray) -> np.ndarray:
    """Compute how many texels lie across a pixel on each triangle, in the direction with most, [F]; 0 without any."""
    if part.uv is None or part.look.picture is None:
        return np.zeros(len(shown))
    places = (shown[:, 1:, :2] - shown[:, :1, :2]) * SIDE / 2
    moved = (part.uv[:, 1:] - part.uv[:, :1]) * part.look.picture.shape[1::-1]
    flat = np.abs(np.linalg.det(places)) < 1e-9
    places[flat] = np.eye(2)
    return np.where(flat, 0, np.linalg.norm(np.linalg.solve(places, moved), 2, axis=(1, 2)))


def draw(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draw triangles [F, 3, 3] in [−1, 1], x right, y up, largest z in front: faces, weights, and where it is sure."""
    side = SIDE * FINE
    depth, second = np.full((side, side), -np.inf), np.full((side, side), -np.inf)
    face, weights = np.full((side, side), -1), np.zeros((side, side, 3))
    places = (triangles[..., :2] * [1, -1] + 1) / 2 * side - 0.5
    for number, (p, z) in enumerate(zip(places, triangles[..., 2], strict=True)):
        x0, y0 = np.maximum(np.ceil(p.min(0)), 0).astype(int)
        x1, y1 = np.minimum(np.floor(p.max(0)), side - 1).astype(int)
        area = (p[1, 0] - p[0, 0]) * (p[2, 1] - p[0, 1]) - (p[1, 1] - p[0, 1]) * (p[2, 0] - p[0, 0])
        if x1 < x0 or y1 < y0 or abs(area) < 1e-12:
            continue
        y, x = np.mgrid[y0 : y1 + 1, x0 : x1 + 1]
        w = np.stack(
            [
                ((p[(k + 1) % 3, 0] - x) * (p[(k + 2) % 3, 1] - y) - (p[(k + 1) % 3, 1] - y) * (p[(k + 2) % 3, 0] - x))
                for k in range(3)
            ],
            -1,
        )
        w = w / area
        here = (w >= 0).all(-1)
        height = w @ z
        box = np.s_[y0 : y1 + 1, x0 : x1 + 1]
        front = here & (height > depth[box])
        second[box] = np.where(front, depth[box], np.where(here, np.maximum(second[box], height), second[box]))
        depth[box] = np.where(front, height, depth[box])
        face[box] = np.where(front, number, face[box])
        weights[box] = np.where(front[..., None], w, weights[box])
    return face, weights, (face >= 0) & (depth > np.maximum(second, -9) + 1e-3)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--all", action="store_true", help="list the files that are right, too")
    options = parser.parse_args()
    total: Counter[str] = Counter()
    for folder in options.folders:
        counts: Counter[str] = Counter()
        for path in sorted([folder] if folder.is_file() else folder.rglob("*")):
            if path.suffix.lower() not in (".glb", ".gltf") or not path.is_file():
                continue
            signal.alarm(300)
            kind, why = compare(path)
            signal.alarm(0)
            counts[kind] += 1
            if kind != "right" or options.all or "left out" in why:
                print(f"{kind:12} {path.relative_to(folder if folder.is_dir() else folder.parent)}: {why}", flush=True)
        print(f"{folder}: {json.dumps(dict(counts))}", flush=True)
        total += counts
    print(f"total: {json.dumps(dict(total))}")


if __name__ == "__main__":
    main()
