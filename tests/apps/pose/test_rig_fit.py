"""Joints and shape from silhouettes and keypoints, and the commands for rigs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from PIL import Image
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.pose.rig_fit import Priors
from tests.meshes.test_rig import tracks

CAMERA = nr.Camera.look_at(nr.get_points_from_angles(6.0, 20.0, torch.tensor([0.0, 60.0, 130.0])), viewing_angle=20)
ANGLES = torch.tensor([[0.0, 0.2, 0.1], [0.5, 0.0, -0.3], [0.0, 0.0, 0.0]])


def bar() -> nr.Rig:
    """A box of two members that a target makes longer, and a tip."""
    vertices, faces = nr.cube()
    both = torch.cat((vertices * torch.tensor([0.3, 0.5, 0.2]), vertices * torch.tensor([0.1, 0.5, 0.4])))
    both[8:, 1] += 1.0
    faces = torch.cat((faces, faces + 8))
    mesh = nr.UVMesh(both, faces, torch.zeros(16, 2), torch.full((2, 2, 3), 0.5))
    upper = (torch.arange(16) >= 8).float()[:, None]
    longer = torch.cat((torch.zeros(16, 1), upper * both[:, 1:2], torch.zeros(16, 1)), 1)
    places = torch.tensor([[0.0, -0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    weights = torch.cat((1 - upper, upper, 0 * upper), 1)
    return nr.Rig(mesh, (-1, 0, 1), places, weights, targets=longer[None], names=("foot", "knee", "tip"))


def goal(rig: nr.Rig, size: int = 64) -> tuple[Tensor, Tensor]:
    """Vertices and silhouettes of a bent, longer bar."""
    pose = rig.pose(ANGLES, torch.tensor([0.4]), translation=torch.tensor([0.1, -0.1, 0.0]))
    return rig.vertices(pose), nr.render(rig.posed(pose), CAMERA, size).alpha


def test_silhouettes_tell_joints_and_shape() -> None:
    rig = bar()
    expected, masks = goal(rig)
    priors = Priors(angles=0.01, shape=0.01)
    found = nr.fit_rig(rig, CAMERA, masks, joints=["foot", "knee"], shape=torch.zeros(1), priors=priors)
    assert (rig.vertices(found.pose) - expected).norm(dim=1).mean() < 0.01 * 2.0
    assert (float(found.shape) - 0.4) ** 2 < 0.03**2
    again = nr.fit_rig(rig, CAMERA, masks, joints=["foot", "knee"], start=found, steps=2, priors=priors, search=0)
    assert (rig.vertices(again.pose) - expected).norm(dim=1).mean() < 0.01 * 2.0


def test_the_search_frees_a_limb() -> None:
    """The knee is bent so far that Gauss-Newton alone ends with a loss of 141."""
    rig = bar()
    pose = rig.pose(torch.tensor([[0.0, 0.0, 0.0], [-2.2, 0.2, 1.4], [0.0, 0.0, 0.0]]))
    masks = nr.render(rig.posed(pose), CAMERA, 48).alpha
    found = nr.fit_rig(rig, CAMERA, masks, joints=["knee"], priors=Priors(angles=0.01))
    assert found.loss < 5
    assert (rig.vertices(found.pose) - rig.vertices(pose)).norm(dim=1).mean() < 0.02 * 2.0


def test_a_keypoint_does_not_lead_away_from_silhouettes() -> None:
    """One keypoint leaves most angles open; fitted alone, it turned a bar away from masks that tell all of them."""
    rig = bar()
    pose = rig.pose(torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 0.2], [0.3, 0.0, 0.4]]))
    masks = nr.render(rig.posed(pose), CAMERA, 64).alpha
    tip = CAMERA[0].project(rig.joints(pose), 64)[0].reshape(-1, 2)[2]
    found = nr.fit_rig(rig, CAMERA, masks, [{"tip": tip.tolist()}, {}, {}], search=0)
    assert (rig.vertices(found.pose) - rig.vertices(pose)).norm(dim=1).mean() < 0.01 * 2.0


def test_keypoints_alone_and_limits() -> None:
    """Keypoints are exact here, so joints come out; those beyond a limit end at it."""
    rig = bar()
    pose = rig.pose(ANGLES)
    pixels = CAMERA.project(rig.joints(pose), 64)[0]
    points = [{name: one.tolist() for name, one in zip(rig.names, view, strict=True)} for view in pixels]
    priors = Priors(angles=1e-3)
    found = nr.fit_rig(rig, CAMERA, keypoints=points, size=64, joints=[0, 1], priors=priors)
    assert (rig.joints(found.pose) - rig.joints(pose)).abs().max() < 2e-3
    limited = nr.fit_rig(rig, CAMERA, keypoints=points, size=64, joints=[0, 1], limits=0.25, priors=priors)
    assert limited.angles[1].abs().max() <= 0.25


def test_errors(tmp_path: Path) -> None:
    rig = bar()
    with pytest.raises(ValueError, match="masks: expected masks or keypoints, got neither"):
        nr.fit_rig(rig, CAMERA)
    with pytest.raises(ValueError, match="size: expected the size of the pictures"):
        nr.fit_rig(rig, CAMERA, keypoints=[{"tip": (1, 2)}] * 3)
    with pytest.raises(
        ValueError, match="keypoints of view 0: expected a joint of the rig, such as 'foot', got 'nose'"
    ):
        nr.fit_rig(rig, CAMERA, keypoints=[{"nose": (1, 2)}, {}, {}], size=64)
    for options, message in (
        ({"joints": [7]}, "joints: expected a joint of the rig"),
        ({"masks": torch.zeros(3, 8, 8)}, "masks: expected the rig in at least one, got empty masks"),
        ({"limits": torch.tensor([[[1.0] * 3, [-1.0] * 3]] * len(rig.parents))}, "limits: expected the least angle"),
    ):
        with pytest.raises(ValueError, match=message):
            nr.fit_rig(rig, CAMERA, **{"masks": torch.ones(3, 8, 8), **options})
    file = tmp_path / "points.json"
    for content in (
        "{",
        "{}",
        '[{"tip": [1]}]',
        '[{"tip": [1, 2, -1]}]',
        '[{"tip": "here"}]',
        "[1]",
        '[{"tip": [1, NaN]}]',
    ):
        file.write_text(content)
        with pytest.raises(ValueError, match=r"points\.json"):
            nr.load_keypoints(file)


def test_render_at_a_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The picture of a time is that of the posed mesh, and an animation has its frames."""
    moving = tracks()["wave"]
    rig = bar().replace(animations={"wave": [track for track in moving if track.path != "weights"]})
    file, picture, film = (str(tmp_path / name) for name in ("bar.glb", "bar.png", "bar.gif"))
    rig.save(file)
    CAMERA[0].save(tmp_path / "cameras.json", (32, 32), ["no.png"])
    view = ["--camera", str(tmp_path / "cameras.json"), "--no-light", "--shading", "flat"]
    assert cli.main(["render", file, "-o", picture, "--time", "0.3", *view]) == 0
    expected = nr.render(rig.at(0.3), CAMERA[0], 32, light=None, background=(1.0, 1.0, 1.0)).rgb[0]
    assert (nr.load_image(picture).movedim(2, 0) - expected).abs().max() <= 1.01 / 255
    assert cli.main(["render", file, "--animate", film, "--size", "16", "--fps", "4", "--animation", "wave"]) == 0
    with Image.open(film) as frames:
        assert frames.n_frames == 8  # type: ignore[attr-defined]
    for wrong, sentence in (
        (["--animate", film, "--time", "1"], "--animate: expected --time for one moment"),
        (["-o", picture, "--time", "1", "--animation", "run"], "animation: expected 'wave' or a number below 1"),
        (["-o", picture, "--animation", "wave"], "--animation: expected --time or --animate"),
        (["--animate", str(tmp_path / "a.png")], "--animate: expected a .gif, a .mp4 or numbers"),
    ):
        assert cli.main(["render", file, *wrong]) != 0
        assert sentence in " ".join(capsys.readouterr().err.split())


@pytest.mark.slow
def test_pose_of_a_rig(tmp_path: Path) -> None:
    """Two moments of three views; the animation of the result is what was found."""
    rig = bar()
    rig.save(tmp_path / "bar.glb")
    names = [f"{number}.png" for number in range(6)]
    expected, masks = goal(rig)
    (tmp_path / "views").mkdir()
    for name, mask in zip(names, (*masks, *masks), strict=True):
        nr.save_image(tmp_path / "views" / name, mask)
    CAMERA.save(tmp_path / "cameras.json", (64, 64), names[:3])
    inputs = [str(tmp_path / name) for name in ("bar.glb", "views")]
    options = [
        "-o",
        str(tmp_path / "out"),
        "--camera",
        str(tmp_path / "cameras.json"),
        "--rig",
        "--shape",
        "--no-photos",
    ]
    assert cli.main(["pose", *inputs, *options]) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert [(row["verdict"], row["advice"]) for row in report["poses"]] == [("match", [])] * 2
    found = nr.Rig.load(tmp_path / "out" / "rig.glb")
    nr.save_image(tmp_path / "views" / names[4], torch.zeros(64, 64))
    assert cli.main(["pose", *inputs, *options, "--force"]) == 1  # and the first moment is kept
    assert len(json.loads((tmp_path / "out" / "report.json").read_text())["poses"]) == 1
    # Masks of 8 bits, and priors that pull towards rest.
    assert (found.vertices(found.animated(0.0, "found")) - expected).norm(dim=1).mean() < 0.03 * 2.0
