"""Half and double of constants of masks in photographs: ``python -m benchmarks.photo_constants SET [SET …]``.

A set is a folder of `benchmarks.path_traced` with the result of its fit ``alone``. Three stages are measured by
themselves, so that nothing is fitted. Place: distance of the cube around the object from that around the true mesh,
in halves of its side, the logarithm of the ratio of their sides, and the angle of the ground in degrees. Sharpening:
mean IoU with the true masks of 320 pixels, from these dilated and eroded by three pixels. Video: a painting moves
past in 120 frames of 480 × 320, each blurred by 0 to 3 pixels; the mean sharpness of 12 chosen frames.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from types import ModuleType

import numpy as np
import torch
from scipy import ndimage

import neural_renderer as nr
from neural_renderer.apps.common.pictures import ffmpeg
from neural_renderer.apps.fit.cameras import Similarity
from neural_renderer.apps.fit.photos import place, video
from neural_renderer.apps.fit.photos.masks import sharpen
from neural_renderer.camera.files import read_camera_file
from neural_renderer.io.images import load_reduced

from .half_and_double import table
from .verdicts import in_order

_SIDE, _VIEWS, _WRONG = 320, 4, 3  # longer side of pictures, views of a set whose outlines are sharpened, pixels
_CONSTANTS: dict[ModuleType, tuple[str, ...]] = {
    place: (
        *("SHARE", "_TRIALS", "FLAT", "_LEAST_POINTS", "_LEAST_SHARE", "_MOST_BELOW", "_TAIL", "_APART", "_LARGER"),
        "_OUTLYING",
    ),
    sharpen: ("_BAND", "_WINDOW", "_NOISE", "_MOST", "_SHAPE"),
}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.photo_constants", description=__doc__)
    parser.add_argument("sets", type=Path, nargs="+", help="folders of photographs with a fit")
    sets = [Posed(folder) for folder in parser.parse_args().sets]
    measures = {place: Posed.place, sharpen: Posed.sharpen}
    for module, names in _CONSTANTS.items():

        def score(module: ModuleType = module) -> str:
            return ", ".join(f"{value:.3f}" for value in np.mean([measures[module](one) for one in sets], 0))

        table({module: names}, score)
    with tempfile.TemporaryDirectory() as place_of_clip:
        clip = Path(place_of_clip) / "clip.mp4"
        write_clip(clip)

        def sharpness() -> str:
            frames = [frame.mean(2) for *_, frame in video.choose_frames(clip, 12, 480)]
            return f"{np.mean([video.sharpness(frame) for frame in frames]):.3f}"

        table({video: ("_CANDIDATES", "_SIDE")}, sharpness)


def write_clip(path: Path) -> None:
    """Write frames of a painting that moves past, each with another blur."""
    random = np.random.default_rng(0)
    painting = nr.load_image(Path(__file__).resolve().parents[1] / "examples/data/starry_night.jpg").numpy()
    large = ndimage.zoom(painting, (960 / painting.shape[0], 960 / painting.shape[1], 1), order=1).clip(0, 1)
    command = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", "480x320", "-r", "15", "-i", "pipe:0"]
    with ffmpeg.running([*command, "-crf", "16", ffmpeg.to_file(path)], reads=True) as pipe:
        for number, blur in enumerate(random.uniform(0, 3, 120)):
            part = large[320:640, 4 * number : 4 * number + 480]
            pipe.write((255 * ndimage.gaussian_filter(part, (blur, blur, 0))).astype(np.uint8).tobytes())


class Posed:
    """Photographs with cameras that were found, and the true mesh and masks."""

    def __init__(self, folder: Path) -> None:
        found, true = (read_camera_file(folder / name) for name in ("alone/sparse/0/images.bin", "cameras.json"))
        names = [entry.name for entry in found.images]
        height, width = load_reduced(folder / "alone/images" / names[0], least=_SIDE)[0].shape[:2]
        scale = _SIDE / max(height, width)
        self.size = round(scale * height), round(scale * width)
        if found.points is None:
            raise ValueError(f"{folder}: expected points of structure from motion, got none")
        self.camera, self.points = found.cameras(self.size), found.points
        motion = Similarity.between(in_order(true, names, self.size), self.camera)
        self.vertices = motion.points(nr.Mesh.load(folder / "truth.ply", texture_size=2).vertices.detach())
        up = torch.stack((torch.zeros(3), torch.tensor([0.0, 1.0, 0.0])))
        self.up = torch.nn.functional.normalize(motion.points(up).diff(dim=0)[0], dim=0)
        self.pairs = [self._pair(folder, name) for name in names[:: max(1, len(names) // _VIEWS)][:_VIEWS]]

    def _pair(self, folder: Path, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Load a photograph [H, W, 3] and its true mask [H, W]."""
        mask = next((folder / "masks").glob(f"{Path(name).stem}.*"))
        parts = [
            load_reduced(file, least=_SIDE)[0].permute(2, 0, 1)[None] for file in (folder / "alone/images" / name, mask)
        ]
        image, alpha = (torch.nn.functional.interpolate(part, self.size, mode="area")[0].numpy() for part in parts)
        return image[:3].transpose(1, 2, 0), alpha[0] > 0.5

    def place(self) -> np.ndarray:
        """Measure the errors of the place: centre, side, and ground."""
        found = place.find_place(self.camera, self.points, self.size)
        low, high = self.vertices.amin(0).double().numpy(), self.vertices.amax(0).double().numpy()
        half = float((high - low).max()) / 2
        away = float(np.linalg.norm(found.center - (low + high) / 2)) / half
        cosine = 0.0 if found.ground is None else float(found.ground[:3] @ self.up.double().numpy())
        return np.array([away, np.log(found.half / half), np.degrees(np.arccos(min(cosine, 1.0)))])

    def sharpen(self) -> np.ndarray:
        """Measure the IoU of masks that were dilated and eroded, sharpened."""
        found = []
        for image, mask in self.pairs:
            for change in (ndimage.binary_dilation, ndimage.binary_erosion):
                moved = sharpen.sharpen(image, change(mask, iterations=_WRONG))
                found.append((moved & mask).sum() / (moved | mask).sum())
        return np.array([np.mean(found)])


if __name__ == "__main__":
    main()
