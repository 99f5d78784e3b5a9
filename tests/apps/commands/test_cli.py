"""The console command: help, pictures of each mode, errors as one sentence, exit codes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import torch
from PIL import Image

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.info import command as info
from tests.programs import run_python
from tests.rounding import STEP


@pytest.fixture
def ball(tmp_path: Path) -> str:
    path = tmp_path / "ball.obj"
    nr.save_obj(path, *nr.icosphere(2))
    return str(path)


def render(ball: str, output: Path, *options: str) -> torch.Tensor:
    assert cli.main(["render", ball, "-o", str(output), *options]) == 0
    return nr.load_image(output)


def fails(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one sentence of a command that ends with 1."""
    assert cli.main(list(arguments)) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    return captured.err.strip()


@pytest.mark.parametrize("command", ["render", "info", "demo"])
def test_help_of_each_command(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([command, "--help"]) == 0
    assert f"Example: neural-renderer {command}" in capsys.readouterr().out


@pytest.mark.parametrize(
    "command", ["render MESH", "fit IMAGES", "style MESH PAINTING", "dream MESH", "reconstruct train DATA OUT"]
)
def test_usage_names_the_arguments(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The text of the help calls them by the same names."""
    words = command.split()
    assert cli.main([word for word in words if word.islower()] + ["--help"]) == 0
    usage = capsys.readouterr().out.partition("\n\n")[0]
    assert usage.rpartition("]")[2].split() == [word for word in words if word.isupper()]


def test_help_lists_the_commands(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([]) == 0
    out = capsys.readouterr().out
    assert all(name in out and command.summary in out for name, command in cli.COMMANDS.items())


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"neural-renderer {nr.__version__}\n"


@pytest.mark.parametrize("arguments", [["nonsense"], ["render"], ["render", "a.obj", "-o", "b.png", "--size", "big"]])
def test_wrong_usage_is_2(arguments: list[str]) -> None:
    assert cli.main(arguments) == 2


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ["rendr", "a.obj"],
            "neural-renderer: expected one of render, .*, got 'rendr'; did you mean render",
        ),
        (["xyz"], "neural-renderer: expected one of render, .*, demo, got 'xyz'$"),
        (["reconstruct", "trian"], "neural-renderer reconstruct: expected one of .*, got 'trian'; did you mean train"),
        (["render", "a.obj", "-o", "b.png", "--size", "100x200"], "--size: expected a side, or .*, got '100x200'"),
        (["render", "a.obj", "-o", "b.png", "--size"], "--size: expected a side, or height and width .*, got ''"),
        (["render", "a.obj", "-o", "b.png", "--size=big"], "--size: expected .* such as --size 480 640, .*, got 'big'"),
    ],
)
def test_wrong_usage_is_one_sentence(arguments: list[str], sentence: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(arguments) == 2
    said = capsys.readouterr().err
    assert re.match(sentence, said) and said.count("\n") == 1


@pytest.mark.parametrize("words", [["--iterations", "0"], ["--iterations=0"], ["--steps", "0"]])
@pytest.mark.parametrize("command", ["fit x", "style x y", "dream x", "demo"])
def test_steps_have_one_name(command: str, words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """And a former one, which still works."""
    assert fails(capsys, *command.split(), "-o", "out", *words) == "--steps: expected at least 1, got 0"


def test_exit_codes_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--help"]) == 0
    codes = " ".join(capsys.readouterr().out.split()).partition("Exit codes: ")[2].partition(". With")[0]
    assert re.findall(r"\b\d+\b", codes) == ["0", "1", "2", "3", "130"]


LOADED = "import neural_renderer, torch"  # in this order
WAIT_POLICY = re.compile(r"OMP_WAIT_POLICY *= *'(\w+)'")


def test_an_option_given_twice_is_not_half_lost(ball: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    twice = ("--save", "depth", str(tmp_path / "d.npy"), "--save", "normal", str(tmp_path / "n.npy"))
    assert cli.main(["render", ball, *twice]) == 2
    assert capsys.readouterr().err == "--save: expected at most once, with all its values, got it 2 times\n"
    assert not list(tmp_path.glob("*.npy"))


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ((), "expected names and files in turn, such as rgb rgb.png, got ''"),
        (("depth",), "expected names and files in turn, such as rgb rgb.png, got 'depth'"),
        (
            ("depth", "d.png", "normal"),
            "expected names and files in turn, such as rgb rgb.png, got 'depth d.png normal'",
        ),
        (("normals", "n.png"), "expected each name to be one of rgb, alpha, depth, normal, position, uv, face_index, "),
    ],
)
def test_pairs_that_do_not_fit_are_named(words, problem, ball: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["render", ball, "--save", *words, "--size", "8"]) == 2
    assert capsys.readouterr().err.startswith(f"--save: {problem}")


def test_the_package_runs_as_a_module() -> None:
    """``python -m neural_renderer`` is the command."""
    done = run_python("-m", "neural_renderer", "--version")
    assert (done.returncode, done.stdout) == (0, f"neural-renderer {nr.__version__}\n")


@pytest.mark.slow
def test_waiting_threads_sleep_unless_the_user_chose(monkeypatch: pytest.MonkeyPatch) -> None:
    """Spinning ones make a fit beside two busy programs take nine times as long."""
    monkeypatch.delenv("OMP_WAIT_POLICY")
    for chosen, expected in (({}, "PASSIVE"), ({"OMP_WAIT_POLICY": "ACTIVE"}, "ACTIVE")):
        shown = run_python("-c", LOADED, OMP_DISPLAY_ENV="TRUE", **chosen).stderr
        assert set(WAIT_POLICY.findall(shown)) == {expected}, shown


def test_rgb_is_lit_from_the_front(ball: str, tmp_path: Path) -> None:
    picture = render(ball, tmp_path / "a.png", "--size", "48", "64")
    assert picture.shape == (48, 64, 3)
    assert torch.equal(picture[0, 0], torch.ones(3))
    assert 0.3 < picture[24, 32, 0] < 0.9
    assert picture[14, 28, 0] > picture[36, 38, 0] + 0.1  # brighter on the side of the light


def test_no_light_draws_the_colour_itself(ball: str, tmp_path: Path) -> None:
    picture = render(ball, tmp_path / "a.png", "--size", "32", "--no-light", "--background", "0", "0.5", "1")
    assert torch.allclose(picture[16, 16], torch.tensor(0.82), atol=0.51 * STEP)
    assert torch.allclose(picture[0, 0], torch.tensor([0, 0.5, 1]), atol=0.51 * STEP)


def test_images_are_shown_at_full_detail(tmp_path: Path) -> None:
    stripes = (torch.arange(32) % 2).float().expand(3, 32, 32)
    nr.save_image(tmp_path / "stripes.png", stripes)
    square = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl a\nf 1/1 2/2 3/3 4/4\n"
    (tmp_path / "a.obj").write_text("mtllib a.mtl\n" + square)
    (tmp_path / "a.mtl").write_text("newmtl a\nmap_Kd stripes.png\n")
    front = ["--size", "256", "--azimuth", "180", "--elevation", "0", "--orthographic", "--no-light"]
    middle = slice(100, 156)  # within the square
    sharp = render(str(tmp_path / "a.obj"), tmp_path / "sharp.png", *front)[middle, middle, 0]
    baked = render(str(tmp_path / "a.obj"), tmp_path / "baked.png", *front, "--texture-size", "4")[middle, middle, 0]
    assert sharp.max() > 0.95 and sharp.min() < 0.05 and (sharp - sharp[0]).abs().max() < 0.01
    assert baked.std() < 0.6 * sharp.std()


@pytest.mark.parametrize("lens", [[], ["--orthographic"]])
def test_silhouette_fits_into_the_picture(ball: str, tmp_path: Path, lens: list[str]) -> None:
    for height, width in ((64, 64), (64, 40)):
        size = ["--size", str(height), str(width)]
        picture = render(ball, tmp_path / "a.png", *size, "--mode", "silhouettes", *lens)[..., 0]
        assert picture[32, width // 2] == 1
        assert not picture[0].any() and not picture[:, 0].any() and not picture[:, -1].any()
        across = (picture[32] > 0.5).sum().item()
        assert 0.85 * min(height, width) < across < min(height, width)


def test_depth_is_bright_where_near_and_black_outside(ball: str, tmp_path: Path) -> None:
    picture = render(ball, tmp_path / "a.png", "--size", "48", "--mode", "depth")[..., 0]
    assert picture[24, 24] > 0.95
    assert 0.1 < picture[24, 4] < 0.75
    assert picture[0, 0] == 0


def test_normals_are_those_of_the_camera(ball: str, tmp_path: Path) -> None:
    picture = render(ball, tmp_path / "a.png", "--size", "64", "--mode", "normals", "--orthographic")
    assert torch.allclose(picture[32, 32], torch.tensor([0.5, 0.5, 1]), atol=0.03)  # of flat faces
    assert torch.equal(picture[0, 0], torch.ones(3))
    blue = render(ball, tmp_path / "b.png", "--size", "64", "--mode", "normals", "--background", "0", "0", "1")
    assert blue[0, 0].tolist() == [0, 0, 1]
    assert picture[32, 55, 0] > 0.85 and picture[32, 8, 0] < 0.15  # red to the right
    assert picture[8, 32, 1] > 0.85 and picture[55, 32, 1] < 0.15  # green up


def test_azimuth_180_sees_the_side_of_plus_z(tmp_path: Path) -> None:
    path = tmp_path / "two.ply"
    vertices, faces = nr.cube()
    textures = torch.zeros(12, 2, 2, 2, 3)
    front = (vertices[faces.long()][..., 2] == 1).all(1)
    assert front.sum() == 2
    textures[front, ..., 0] = 1
    nr.save_mesh(path.with_suffix(".glb"), vertices, faces, textures)
    for azimuth, red in (("180", 1.0), ("0", 0.0), ("90", 0.0)):
        options = ["--azimuth", azimuth, "--elevation", "0", "--size", "16", "--no-light"]
        picture = render(str(path.with_suffix(".glb")), tmp_path / "a.png", *options)
        assert picture[8, 8, 0].item() == pytest.approx(red, abs=0.02)


def test_transparent_background(ball: str, tmp_path: Path) -> None:
    picture = render(ball, tmp_path / "a.png", "--size", "40", "--background", "transparent", "--no-light")
    assert picture.shape == (40, 40, 4)
    assert picture[0, 0, 3] == 0 and picture[20, 20, 3] == 1
    outline = (picture[..., 3] > 0) & (picture[..., 3] < 1)
    assert outline.any()
    assert torch.allclose(picture[outline][:, :3], torch.tensor(0.82), atol=0.01)  # not darkened by the background


def test_turntable(ball: str, tmp_path: Path) -> None:
    for name in ("a.gif", "a.mp4"):
        path = tmp_path / name
        assert cli.main(["render", ball, "-o", str(path), "--turntable", "3", "--size", "32"]) == 0
        assert path.stat().st_size > 100
    with Image.open(tmp_path / "a.gif") as animation:
        assert animation.n_frames >= 1  # a ball looks alike from all sides


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["-o", "a.bmp"], "--output: expected a name that ends in .png, .jpg, .jpeg, .gif, .mp4, got 'a.bmp'"),
        (["-o", "a.png", "--size", "0"], "--size: expected between 1 and 32768 pixels, got 0"),
        (["-o", "a.png", "--size", "4", "0"], "--size: expected between 1 and 32768 pixels, got (4, 0)"),
        (["-o", "a.png", "--texture-size", "2000"], "--texture-size: expected cubes of at most 8 GiB, got"),
        (["-o", "a.png", "--texture_size=2000"], "--texture-size: expected cubes of at most 8 GiB, got"),
        (["-o", "a.png", "--elevation", "90"], "--elevation: expected a number above -90 and below 90, got 90.0"),
        (["-o", "a.png", "--viewing-angle", "nan"], "--viewing-angle: expected a number above 0 and below 90, got nan"),
        (["-o", "a.png", "--distance", "-1"], "--distance: expected a number above 0, got -1.0"),
        (["-o", "a.png", "--azimuth", "inf"], "--azimuth: expected a finite number of degrees, got inf"),
        (["-o", "a.png", "--texture-size", "0"], "--texture-size: expected at least 1, got 0"),
        (
            ["-o", "a.png", "--turntable", "9"],
            "--output: expected a .gif or .mp4, a folder or numbers such as %03d.png",
        ),
        (["-o", "a.gif", "--turntable", "0"], "--turntable: expected at least 1, got 0"),
        (["-o", "a.gif", "--fps", "0"], "--fps: expected a number above 0, got 0.0"),
        (["-o", "a.jpg", "--background", "transparent"], "--background transparent: expected a .png, got 'a.jpg'"),
        (
            ["-o", "a.png", "--mode", "depth", "--background", "white"],
            "--background: expected --mode rgb or normals, got",
        ),
        (["-o", "a.png", "--mode", "silhouettes", "--background", "transparent"], "got silhouettes (always on black)"),
        (["-o", "a.png", "--background", "0", "0", "2"], "--background: expected three numbers from 0 to 1"),
    ],
)
def test_errors_are_one_sentence(
    ball: str, options: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert sentence in fails(capsys, "render", ball, *options)


def test_errors_about_the_mesh(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = str(tmp_path / "a.png")
    assert "nowhere.obj: expected a file, got nothing there" in fails(capsys, "render", "nowhere.obj", "-o", output)
    (tmp_path / "model.xyz").write_text("")
    assert "expected a file that ends in .obj" in fails(capsys, "render", str(tmp_path / "model.xyz"), "-o", output)
    (tmp_path / "broken.obj").write_text("v 1 2\nf 1 2 3\n")
    assert "broken.obj" in fails(capsys, "render", str(tmp_path / "broken.obj"), "-o", output)


@pytest.mark.filterwarnings("always")
def test_warnings_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a  b.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nmtllib absent.mtl\nf 1 2 3\n")
    render(str(path), tmp_path / "a.png", "--size", "8")
    assert capsys.readouterr().err == f"{path}: its material file 'absent.mtl' is missing\n"


def test_a_kernel_cache_that_cannot_be_written(ball: str, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    command = ["-m", "neural_renderer", "render", ball, "-o", str(tmp_path / "a.png")]
    done = run_python(*command, WARP_CACHE_PATH=str(tmp_path / "file"))
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
    assert str(tmp_path / "file") in done.stderr and "WARP_CACHE_PATH" in done.stderr


def test_debug_shows_where(monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = ["render", "nowhere.obj", "-o", "a.png"]
    with pytest.raises(FileNotFoundError):
        cli.main([*arguments, "--debug"])
    monkeypatch.setenv("NEURAL_RENDERER_DEBUG", "1")
    with pytest.raises(FileNotFoundError):
        cli.main(arguments)


def test_interruption_is_one_word(
    ball: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("neural_renderer.apps.render.command.UVMesh.load", interrupted)
    assert cli.main(["render", ball, "-o", "a.png"]) == 130
    assert capsys.readouterr() == ("", "interrupted\n")


def test_info_says_ok(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["info"]) == 0
    out = capsys.readouterr().out
    assert "check on cpu" in out and "ok" in out and torch.__version__ in out and nr.__version__ in out


def test_info_says_what_differs(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(info, "_CASES", tuple((c, p, 0.5, [[1.0, 0.0]] * 3) for c, p, _, _ in info._CASES))
    assert cli.main(["info"]) == 1
    assert "gradient 1: expected agreement within 0.01" in " ".join(capsys.readouterr().out.split())


def test_as_a_program() -> None:
    done = run_python("-m", "neural_renderer", "render", "nowhere.obj", "-o", "a.png")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == "nowhere.obj: expected a file, got nothing there\n"
