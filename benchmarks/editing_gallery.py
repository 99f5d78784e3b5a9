"""Gallery of docs/tools/editing.md: two meshes in the style of five paintings, and after DeepDream.

    python -m benchmarks.editing_gallery MESHES PAINTINGS --vgg VGG --googlenet GOOGLENET --uv MESH MESH MESH -o gallery

runs `neural-renderer style` and `dream` one after the other; runs that are finished in the folder are skipped. Then it
combines the pictures, and prints the measures.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import torch
from PIL import Image

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.edit.edit_pictures import normalized_like, photographs

MESHES = {"bunny_kato": "4", "teapot_kato": "6"}  # texels along an edge; the teapot has half as many faces
PAINTINGS = {
    "elder1": "Bruegel, The Tower of Babel",
    "munch1": "Munch, The Scream",
    "gris1": "Gris, Portrait of Picasso",
    "hokusai1": "Hokusai, The Great Wave",
    "gogh2": "van Gogh, The Starry Night",
}
UV_PAINTINGS = ("hokusai1", "munch1", "gogh2")  # for meshes that are painted in their own texture coordinates
STYLE = ["--steps", "300", "--batch", "2"]
_SIDE = 256


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", type=Path, help=f"folder with {', '.join(MESHES)} (.obj)")
    parser.add_argument("paintings", type=Path, help=f"folder with {', '.join(PAINTINGS)} (.jpg)")
    parser.add_argument("--vgg", required=True, help="weights of the network of style")
    parser.add_argument("--googlenet", required=True, help="weights of the network of dream")
    parser.add_argument("--uv", nargs="*", type=Path, default=[], help="up to three meshes with texture coordinates")
    parser.add_argument("-o", "--output", type=Path, default=Path("gallery"))
    given = parser.parse_args()
    for painting in PAINTINGS:
        for mesh, texels in MESHES.items():
            path, common = str(given.meshes / f"{mesh}.obj"), ["--texture-size", texels]
            picture = str(given.paintings / f"{painting}.jpg")
            _run(given.output / mesh / painting, ["style", path, picture, "--weights", given.vgg, *STYLE, *common])
    for mesh in MESHES:
        path = str(given.meshes / f"{mesh}.obj")
        _run(given.output / mesh / "dream", ["dream", path, "--weights", given.googlenet])
    for path, painting in zip(given.uv, UV_PAINTINGS, strict=False):
        picture = str(given.paintings / f"{painting}.jpg")
        common = ["--weights", given.vgg, *STYLE, "--uv", "512"]
        _run(given.output / path.stem / painting, ["style", str(path), picture, *common])
    together(given.output, given.meshes, given.paintings, given.uv)
    return 0


def together(folder: Path, meshes: Path, paintings: Path, uv: list[Path]) -> None:
    """Write ``styles.jpg``, ``dreams.jpg`` and ``uv.jpg`` to the folder, and print the numbers."""
    print("| mesh | | steps | before | after | change | vertices, mean | most | s | share of time")
    columns, dreams = [_column([_painting(paintings / f"{name}.jpg") for name in PAINTINGS])], []
    for mesh in MESHES:
        start = nr.Mesh.load(meshes / f"{mesh}.obj")
        for azimuth in (150.0, 285.0):
            results = [nr.Mesh.load(folder / mesh / name / "mesh.obj", 8) for name in PAINTINGS]
            columns.append(_column([_picture(result, start, azimuth) for result in results]))
        dream = nr.Mesh.load(folder / mesh / "dream" / "mesh.obj", 8)
        dreams += [_picture(dream, start, azimuth) for azimuth in (150.0, 30.0)]
        for name in (*PAINTINGS, "dream"):
            _tell(mesh, name, json.loads((folder / mesh / name / "report.json").read_text()))
    painted: list[torch.Tensor] = []
    for path, painting in zip(uv, UV_PAINTINGS, strict=False):
        before = nr.UVMesh.load(path)
        after = nr.UVMesh.load(folder / path.stem / painting / "mesh.obj")
        painted += [_column([_picture(mesh, before, azimuth) for mesh in (before, after)]) for azimuth in (150.0, 30.0)]
        _tell(path.stem, painting, json.loads((folder / path.stem / painting / "report.json").read_text()))
    if painted:
        Image.fromarray(_pixels(torch.cat(painted, 2))).save(folder / "uv.jpg", quality=88)
    Image.fromarray(_pixels(torch.cat(columns, 2))).save(folder / "styles.jpg", quality=88)
    Image.fromarray(_pixels(torch.cat(dreams, 2))).save(folder / "dreams.jpg", quality=88)


def _run(folder: Path, arguments: list[str]) -> None:
    report = folder / "report.json"
    if report.is_file() and json.loads(report.read_text())["finished"]:
        return
    code = cli.main([*arguments, "-o", str(folder), "--turntable", "0", "--resume"])
    if code:
        sys.exit(code)


def _tell(mesh: str, name: str, report: dict[str, Any]) -> None:
    before, after = report["held_out"]["before"], report["held_out"]["after"]
    change = f"{after / before:.1f} ×" if name == "dream" else f"{after / before - 1:.0%}"
    moved, share = report["moved"], report["share_of_time"]
    print(
        f"| {mesh} | {name} | {report['steps']} | {before:.3g} | {after:.3g} | {change} | {moved['mean']:.2%} "
        f"| {moved['most']:.1%} | {report['seconds']:.0f} | {share}"
    )


def _picture(mesh: nr.Mesh | nr.UVMesh, start: nr.Mesh | nr.UVMesh, azimuth: float) -> torch.Tensor:
    return next(photographs(normalized_like(mesh, start), [azimuth], _SIDE))


def _painting(path: Path) -> torch.Tensor:
    with Image.open(path) as image:
        picture = image.convert("RGB")
        picture.thumbnail((_SIDE - 40, _SIDE - 40), Image.Resampling.LANCZOS)
    card = Image.new("RGB", (_SIDE, _SIDE), (236, 238, 241))
    card.paste(picture, ((_SIDE - picture.width) // 2, (_SIDE - picture.height) // 2))
    return _tensor(card)


def _tensor(image: Image.Image) -> torch.Tensor:
    """Load a picture, [3, H, W] in [0, 1]."""
    pixels = torch.frombuffer(bytearray(image.tobytes()), dtype=torch.uint8)
    return pixels.reshape(image.height, image.width, 3).permute(2, 0, 1) / 255


def _column(pictures: list[torch.Tensor]) -> torch.Tensor:
    return torch.cat(pictures, 1)


def _pixels(image: torch.Tensor) -> Any:
    return (image.clamp(0, 1).permute(1, 2, 0) * 255 + 0.5).to(torch.uint8).numpy()


if __name__ == "__main__":
    sys.exit(main())
