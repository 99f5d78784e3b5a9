"""Half and double of constants of structure from motion: ``python -m benchmarks.motion_constants SET …``.

A set is a folder of `benchmarks.path_traced`. Twelve neighbouring photographs of it are placed. Printed are the number
that was placed, the mean angle in degrees between found and true cameras, and the mean distance of their positions in
percent of that from the object, both after the similarity that fits best; with commas between the sets. ``lens``
constants choose what of the lens is fitted, ``pairs`` which pairs of more photographs are matched.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path

import torch

from neural_renderer.apps.fit.cameras import Similarity
from neural_renderer.apps.fit.photos import motion
from neural_renderer.apps.fit.photos.copies import IMAGES, Photographs
from neural_renderer.camera.files import read_camera_file

from .half_and_double import table
from .verdicts import in_order

_COUNT = 12
_OF_FEATURES = ("_FEATURE_SIDE", "_MOST_FEATURES", "_PEAK")
_OF_MATCHES = ("LEAST_MATCHES",)
_OF_CAMERAS = ("_START", "_LEAST_INLIERS", "_LEAST_POSE", "_ERRORS", "_LEAST_ANGLE", "_MANY", "_SHARING")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.motion_constants", description=__doc__)
    parser.add_argument("sets", type=Path, nargs="+", help="folders of photographs with true cameras")
    with tempfile.TemporaryDirectory() as place:
        sets = [Set(folder, Path(place) / folder.name) for folder in parser.parse_args().sets]
        for names, keep in ((_OF_CAMERAS, "matches"), (_OF_MATCHES, "features"), (_OF_FEATURES, "")):

            def score(keep: str = keep) -> str:
                return "; ".join(one.score(keep) for one in sets)

            table({motion: names}, score)


class Set:
    """Photographs that are placed anew, from kept matches or features, or from nothing."""

    def __init__(self, folder: Path, place: Path) -> None:
        self.folder, self.place = folder, place
        true = read_camera_file(folder / "cameras.json")
        self.true, size = true, (100, 100)
        eyes = true.cameras(size).position
        rows = (eyes - eyes[0]).norm(dim=1).argsort()[:_COUNT].tolist()
        (place / IMAGES).mkdir(parents=True)
        for row in rows:
            name = Path(true.images[row].name).name
            shutil.copy(folder / "alone/images" / name, place / IMAGES / name)
        self.names = sorted(file.name for file in (place / IMAGES).iterdir())
        self.score("")
        shutil.copy(place / motion._DATABASE, place / "kept.db")

    def score(self, keep: str) -> str:
        for file in self.place.glob(f"{motion._DATABASE}*"):
            file.unlink()
        shutil.rmtree(self.place / "sparse", ignore_errors=True)
        if keep:
            shutil.copy(self.place / "kept.db", self.place / motion._DATABASE)
        if keep == "features":
            import pycolmap

            with pycolmap.Database.open(self.place / motion._DATABASE) as database:
                database.clear_matches()
                database.clear_two_view_geometries()
        try:
            motion.find_cameras(Photographs(self.place, dict.fromkeys(self.names, 1.0)), lambda *_: None)
        except ValueError:
            return "0"
        found = read_camera_file(self.place / "sparse/0/images.bin")
        size = (100, 100)
        true = in_order(self.true, [entry.name for entry in found.images], size)
        cameras = Similarity.between(found.cameras(size), true).cameras(found.cameras(size))
        turns = torch.einsum("bij,bij->b", cameras.rotation, true.rotation)
        angle = torch.rad2deg(((turns - 1) / 2).clamp(-1, 1).acos()).mean()
        away = (cameras.position - true.position).norm(dim=1).mean() / true.position.norm(dim=1).mean()
        return f"{len(found.images)}, {angle:.2f}°, {100 * away:.2f}%"


if __name__ == "__main__":
    main()
