"""Prediction: frames of meshes, result files, several pictures, error messages."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.reconstruct.data.drawing import PAPER, on_paper
from neural_renderer.apps.reconstruct.data.framing import mirror, scale_to_unit, view_camera
from neural_renderer.apps.reconstruct.data.voxels import voxelize_model
from neural_renderer.apps.reconstruct.evaluation.predict import best_frame, predict_meshes, prediction_picture
from neural_renderer.apps.reconstruct.evaluation.predictors import network_predictor
from neural_renderer.apps.reconstruct.networks.configs import Config


def wedge() -> tuple[Tensor, Tensor]:
    """Make an asymmetric model with counter-clockwise faces."""
    vertices = torch.tensor([[0, 0, 0], [4, 0, 0], [0, 0, 2], [0, 1.5, 0], [4, 0.5, 0.0]])
    faces = torch.tensor([[0, 1, 2], [0, 2, 3], [1, 4, 2], [2, 4, 3], [0, 3, 1], [1, 3, 4]])
    return scale_to_unit(vertices), faces


def volume(vertices: Tensor, faces: Tensor) -> float:
    return torch.linalg.det(vertices[faces.long()].double()).sum().item() / 6


class ConstantNetwork:
    """A network that always predicts the wedge, in the reconstruction frame."""

    config = Config()

    def __init__(self, kind: str) -> None:
        self.kind = kind
        vertices, faces = wedge()
        self._vertices, self.faces = mirror(vertices), faces.flip(1)

    def vertices(self, images: Tensor) -> Tensor:
        assert images.shape[1:] == (4, 64, 64) and images.max() <= 1
        return self._vertices.expand(len(images), -1, -1)

    def occupancy(self, images: Tensor) -> Tensor:
        return voxelize_model(self._vertices, self.faces).float().expand(len(images), -1, -1, -1)


IMAGES = torch.zeros(1, 4, 64, 64, dtype=torch.uint8)


def test_the_mesh_is_the_model_and_not_its_mirror_image() -> None:
    assert volume(*wedge()) > 0
    [(vertices, faces)] = predict_meshes(ConstantNetwork("mesh"), IMAGES)
    assert torch.equal(vertices, wedge()[0]) and volume(vertices, faces) == pytest.approx(volume(*wedge()))


def test_the_mesh_of_voxels_is_as_large_and_outward() -> None:
    [(vertices, faces)] = predict_meshes(ConstantNetwork("voxel"), IMAGES)
    expected, triangles = wedge()
    assert (vertices.amin(0) - expected.amin(0)).abs().max() < 1 / 31
    assert (vertices.amax(0) - expected.amax(0)).abs().max() < 1 / 31
    assert volume(vertices, faces) == pytest.approx(volume(expected, triangles), rel=0.5)
    camera = view_camera(torch.arange(0, 24, 5))
    a, b = (
        nr.render((mirror(points), corners), camera, 64, outputs="alpha").alpha
        for points, corners in ((vertices, faces), (expected, triangles))
    )
    assert nr.metrics.silhouette_iou(a, b).min() > 0.8  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="expected a solid shape"):
        predict_meshes(ConstantNetwork("voxel"), IMAGES, threshold=1.0)


def test_a_full_grid_has_a_closed_surface() -> None:
    network = ConstantNetwork("voxel")
    network.occupancy = lambda images: torch.ones(1, 32, 32, 32)  # type: ignore[method-assign]
    [(vertices, faces)] = predict_meshes(network, IMAGES)
    assert 1 < volume(vertices, faces) < 1.12 and vertices.abs().max() < 0.54


def test_the_size_is_the_one_at_which_the_prediction_fits() -> None:
    predict = network_predictor(ConstantNetwork("mesh"))
    alpha = predict(IMAGES).silhouettes(torch.tensor([[7]]))[0, 0]
    large = torch.nn.functional.interpolate(alpha[None, None], size=(300, 300), mode="bilinear")[0]
    image = best_frame(predict, large[:, 40:, 10:].expand(4, -1, -1))
    extents = []
    for mask in (alpha > 0.5, image[3] > 127):
        rows, columns = (mask.any(axis).nonzero()[:, 0] for axis in (0, 1))
        extents.append(max(rows[-1] - rows[0], columns[-1] - columns[0]).item() + 1)
    assert abs(extents[0] - extents[1]) <= 3


def wedge_mesh() -> nr.Mesh:
    return nr.Mesh(*wedge())


@pytest.mark.parametrize(
    ("shape", "rows", "columns"),
    [((40, 90), (9, 23), (0, 32)), ((64, 64), (0, 32), (0, 32)), ((200, 5), (0, 32), (15, 16))],
)
def test_sheet_of_any_picture(shape: tuple[int, int], rows: tuple[int, int], columns: tuple[int, int]) -> None:
    """A picture of one half-transparent colour in the middle, the input at half its size, and 16 views of the mesh."""
    color = torch.tensor([0.25, 0.5, 0.75])
    image = torch.randint(0, 256, (4, 64, 64), generator=torch.Generator().manual_seed(0), dtype=torch.uint8)
    sheet = prediction_picture(torch.tensor([*color, 0.5]).expand(*shape, 4), image, wedge_mesh(), size=32)
    assert sheet.shape == (3, 96, 192)
    cells = sheet.unfold(1, 32, 32).unfold(2, 32, 32).permute(1, 2, 0, 3, 4).flatten(0, 1)
    expected = torch.full((3, 32, 32), PAPER)
    expected[:, slice(*rows), slice(*columns)] = ((color + PAPER) / 2)[:, None, None]
    torch.testing.assert_close(cells[0], expected)
    assert torch.equal(cells[1], on_paper(image)[:, ::2, ::2])
    vertices, faces = mirror(wedge_mesh().vertices), wedge_mesh().faces
    seen = nr.render((vertices, faces), view_camera(torch.arange(16) * 1.5), 32, outputs="alpha").alpha
    shown = (cells[2:] != PAPER).any(1).float()
    assert seen is not None and nr.metrics.silhouette_iou(shown, (seen > 0).float()).min() > 0.95


@pytest.fixture
def pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write an object on a wall, the same with transparency, on noise, its mask, and pictures without an object."""
    monkeypatch.setattr(
        "neural_renderer.apps.reconstruct.commands.predict.load_model", lambda *_: ConstantNetwork("mesh")
    )
    wall = torch.full((90, 120, 3), 0.8)
    wall[20:70, 30:60] = torch.tensor([0.2, 0.5, 0.3])
    mask = (wall[..., 0] < 0.5).float()
    nr.save_image(tmp_path / "wall.jpg", wall)
    nr.save_image(tmp_path / "cut.png", torch.cat((wall, mask[..., None]), 2))
    noise = torch.rand(90, 120, 3, generator=torch.Generator().manual_seed(0))
    crowd = torch.where(mask[..., None] > 0, wall, noise)
    nr.save_image(tmp_path / "crowd.png", crowd)
    nr.save_image(tmp_path / "masks" / "crowd.png", mask)
    nr.save_image(tmp_path / "nothing.png", torch.full((50, 50, 3), 0.5))
    (tmp_path / "text.png").write_text("text")
    for name in ("any.ckpt", "a.pt", "m.png"):
        (tmp_path / name).touch()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def command(*arguments: Any) -> int:
    return cli.main(["reconstruct", "predict", "any.ckpt", *map(str, arguments)])


def test_one_picture(pictures: Path) -> None:
    assert command(pictures / "wall.jpg", "-o", pictures / "out" / "thing.glb", "--turntable", "2") == 0
    before = (pictures / "cut.png").read_bytes()
    assert command(pictures / "cut.png", "-o", pictures / "cut.obj", "--turntable", "0") == 0
    assert (pictures / "cut.png").read_bytes() == before  # no texture where the picture is
    assert nr.Mesh.load(pictures / "out" / "thing.glb").num_faces == 6
    with Image.open(pictures / "out" / "thing_sheet.png") as picture:
        assert picture.size == (768, 384)
    with Image.open(pictures / "out" / "thing_turntable.gif") as picture:
        assert picture.n_frames == 2  # type: ignore[attr-defined]


def test_a_small_square_without_transparency_is_cut_out(pictures: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nr.save_image(pictures / "plain.png", torch.cat((torch.full((64, 64, 3), 0.8), torch.ones(64, 64, 1)), 2))
    assert command(pictures / "plain.png", "-o", pictures / "plain.obj") == 1
    assert "plain.png: expected" in capsys.readouterr().err and not (pictures / "plain.obj").exists()


def test_many_pictures_of_which_some_are_wrong(pictures: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = ["wall.jpg", "nothing.png", "cut.png", "text.png", "crowd.png", "nowhere.png"]
    paths = [pictures / name for name in names]
    assert command(*paths, "-o", pictures / "out", "--turntable", "0", "--no-sheet") == 1
    told = capsys.readouterr()
    assert sorted(path.name for path in (pictures / "out").glob("*.glb")) == ["crowd.glb", "cut.glb", "wall.glb"]
    for sentence in (
        "nothing.png: expected an object, got a picture without one",
        "text.png: expected a picture",
        "nowhere.png: expected a file, got nothing there",
    ):
        assert sentence in told.err
    assert "no plain background" in told.err


def test_masks_in_a_folder(pictures: Path) -> None:
    options = ["--mask", pictures / "masks", "--turntable", "0", "--format", "ply"]
    assert command(pictures / "crowd.png", "-o", pictures / "out", *options) == 0
    assert (pictures / "out" / "crowd.ply").is_file()


def test_folders_stand_for_their_pictures(pictures: Path) -> None:
    folder = pictures / "all"
    folder.mkdir()
    for name in ("wall.jpg", "cut.png"):
        (pictures / name).rename(folder / name)
    (folder / "notes.txt").write_text("no picture")
    assert command(folder, "-o", pictures / "out", "--turntable", "0", "--no-sheet") == 0
    assert sorted(path.name for path in (pictures / "out").iterdir()) == ["cut.glb", "wall.glb"]


def test_meshes_in_a_folder_are_replaced_only_if_asked_for(pictures: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["-o", pictures / "out", "--turntable", "0", "--no-sheet"]
    assert command("wall.jpg", *options) == 0
    mesh = pictures / "out" / "wall.glb"
    mesh.write_text("earlier")
    capsys.readouterr()
    assert command("cut.png", "wall.jpg", *options) == 1
    assert capsys.readouterr().err == (
        f"--output: expected a folder without results, got {pictures / 'out'}, which has those of an earlier run; "
        "--force replaces it, another folder keeps it\n"
    )
    assert mesh.read_text() == "earlier" and not (pictures / "out" / "cut.glb").exists()
    assert command("cut.png", *options) == 0 and mesh.read_text() == "earlier"  # one more picture
    assert command("wall.jpg", *options, "--force") == 0 and mesh.read_bytes() != b"earlier"
    mesh.write_text("earlier")
    assert command("wall.jpg", "-o", mesh, "--turntable", "0", "--no-sheet") == 0 and mesh.read_bytes() != b"earlier"


@pytest.mark.parametrize(
    ("images", "options", "sentence"),
    [
        (["wall.jpg", "cut.png"], ["-o", "a.obj"], "--output: expected a folder for 2 meshes, got 'a.obj'"),
        (["wall.jpg"], ["-o", "a.stl"], "--output: expected a name that ends in .obj, .glb, .ply, or a folder, got"),
        (["wall.jpg"], ["-o", "a.obj", "--refine", "-1"], "--refine: expected at least 0, got -1"),
        (["wall.jpg"], ["-o", "a.obj", "--threshold", "2"], "--threshold: expected a number above 0 and below 1"),
        (["wall.jpg"], ["-o", "a.obj", "--mask", "nowhere.png"], "nowhere.png: expected a file, got nothing there"),
        (
            ["wall.jpg"],
            ["-o", "a.obj", "--threshold", "0.4", "--checkpoint", "a.pt"],
            "--threshold: expected a checkpoint",
        ),
        (["masks/none"], ["-o", "out"], "none: expected pictures (.png, "),
        (["nothing.png"], ["-o", "a.obj"], "nothing.png: expected an object, got a picture without one"),
        (["a_sheet.png"], ["-o", "a.obj"], "--output: expected a file that may be replaced, got a_sheet.png, which is"),
        (
            ["cut.png", "wall.jpg"],
            ["-o", "out", "--mask", "m.png"],
            "--mask: expected a folder of masks for 2 pictures",
        ),
    ],
)
def test_what_is_wrong_is_a_sentence(
    pictures: Path, images: list[str], options: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    nr.save_image("a_sheet.png", torch.rand(9, 9, 3))
    Path("masks/none").mkdir()
    assert command(*(name if name == "a_sheet.png" else pictures / name for name in images), *options) == 1
    told = capsys.readouterr().err
    assert sentence in told and told.count("\n") == 1
    assert not Path("a.obj").exists()
