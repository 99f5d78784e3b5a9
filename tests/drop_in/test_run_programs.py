"""`neural-renderer run`, and the contexts behind it: programs that import nvdiffrast, and that say cuda."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.run.cuda_on_cpu import cuda_on_cpu
from neural_renderer.nvdiffrast.stand_in import stand_in

PROGRAM = """
import argparse
import torch
import helper
import nvdiffrast.torch as dr

parser = argparse.ArgumentParser()
parser.add_argument("--size", type=int)
parser.add_argument("--debug", action="store_true")
options = parser.parse_args()
glctx = dr.RasterizeCudaContext(device="cuda")
pos = torch.tensor([[[-0.8, -0.8, 0, 1], [0.8, -0.8, 0, 1], [-0.8, 0.8, 0, 1]]], device="cuda", requires_grad=True)
tri = torch.tensor([[0, 1, 2]], dtype=torch.int32).cuda()
rast, _ = dr.rasterize(glctx, pos, tri, resolution=[options.size, options.size])
image = dr.antialias((rast[..., 3:] > 0).float(), rast, pos, tri)
image.sum().backward()
torch.cuda.synchronize()
print(helper.NAME, options.debug, tuple(image.shape), bool(pos.grad.any()), torch.cuda.is_available())
"""


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(sys, "argv", sys.argv)
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "helper.py").write_text("NAME = 'beside'\n")
    (tmp_path / "fit.py").write_text(PROGRAM)
    yield tmp_path / "fit.py"
    sys.modules.pop("helper", None)


def test_program_runs_with_its_own_arguments(program: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["run", "--device", "cpu", "--ours", str(program), "--size", "16", "--debug"]) == 0
    found = capsys.readouterr()
    assert found.out == "beside True (1, 16, 16, 1) True True\n"
    assert found.err == "neural-renderer: what the program asks of CUDA happens on the CPU\n"
    assert "nvdiffrast.torch" not in sys.modules and torch.cuda.is_available() == torch.cuda.is_available()


def test_module(program: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(program.parent)
    assert cli.main(["run", "-m", "--ours", "fit", "--size", "8"]) == 0
    assert capsys.readouterr().out.startswith("beside False (1, 8, 8, 1)")


def test_exit_codes_and_tracebacks(program: Path, capsys: pytest.CaptureFixture[str]) -> None:
    program.write_text("import sys\nsys.exit(7)\n")
    assert cli.main(["run", str(program)]) == 7
    program.write_text("import sys\nsys.exit('no images')\n")
    assert cli.main(["run", str(program)]) == 1
    assert capsys.readouterr().err.endswith("no images\n")
    program.write_text("def f(:\n")
    assert cli.main(["run", str(program)]) == 1
    assert "runpy" not in capsys.readouterr().err
    program.write_text("def fail():\n    raise KeyError('here')\n\nfail()\n")
    assert cli.main(["run", str(program)]) == 1
    trace = capsys.readouterr().err
    assert f'File "{program}", line 4' in trace and "KeyError: 'here'" in trace and "runpy" not in trace
    assert cli.main(["run", str(program.with_name("none.py"))]) == 1
    assert "none.py: expected a Python file" in capsys.readouterr().err


def test_program_of_the_first_packages(program: Path, capsys: pytest.CaptureFixture[str]) -> None:
    program.write_text(
        "import torch\nimport neural_renderer as nr\n"
        "vertices, faces = nr.icosphere(1)\n"
        "renderer = nr.Renderer(camera_mode='look_at', image_size=16)\n"
        "renderer.eye = nr.get_points_from_angles(2.732, 0, 0)\n"
        "image = renderer(vertices[None].cuda(), faces[None].cuda(), mode='silhouettes')\n"
        "print(tuple(image.detach().cpu().numpy().shape))\n"
    )
    assert cli.main(["run", "--device", "cpu", str(program)]) == 0
    assert capsys.readouterr().out == "(1, 16, 16)\n"


def _ones(device: torch.device) -> torch.Tensor:
    return torch.ones(2, device=device)


CPU = torch.device("cpu")
MADE = {
    "factories": lambda: torch.zeros(2, device="cuda"),
    "a device object": lambda: torch.ones(2, device=torch.device("cuda:0")),
    "data": lambda: torch.tensor([1.0, 2], device="cuda"),
    "like another": lambda: torch.rand_like(torch.zeros(2), device="cuda"),
    "moved": lambda: torch.zeros(2).to("cuda"),
    "moved, with a type": lambda: torch.zeros(2).to(device="cuda:0", dtype=torch.float64),
    "the method cuda": lambda: torch.zeros(2).cuda(non_blocking=True),
    "generators": lambda: torch.rand(2, generator=torch.Generator(device="cuda").manual_seed(1), device="cuda"),
    "types": lambda: torch.zeros(2).type("torch.cuda.DoubleTensor"),
    "old constructors": lambda: torch.cuda.FloatTensor([1.0, 2]),
    "modules": lambda: torch.nn.Linear(2, 2, device="cuda").to("cuda").cuda().weight,
    "scripts": lambda: torch.jit.script(_ones)(torch.device("cuda")),
    "pinned memory": lambda: torch.zeros(2).pin_memory().cuda(),
    "made in pinned memory": lambda: torch.zeros(2, pin_memory=True).cuda(),
}


@pytest.mark.parametrize("case", MADE)
def test_what_is_made_on_cuda_is_made_on_the_cpu(case: str) -> None:
    with cuda_on_cpu(always=True):
        made = MADE[case]()
    assert made.device == CPU and made.shape[0] == 2


def test_devices_have_an_index() -> None:
    """Programs print it, compare devices, and make tensors where others are."""
    with cuda_on_cpu(always=True):
        x = torch.zeros(2, device="cuda")
        assert f"cuda:{x.device.index:d}" == "cuda:0" and x.get_device() == 0
        for number in (x.device.index, x.get_device(), torch.cuda.current_device()):
            assert torch.zeros(1, device=number).device == x.to(number).device == torch.device(number) == x.device
            assert next(torch.nn.Linear(1, 1).to(number).parameters()).device == x.device
        assert x.device == torch.nn.Linear(2, 2).cuda().weight.device == torch.zeros(2).device == torch.device("cpu")
        assert torch.ones(2, device=x.device).to(x.device).device == x.device
        assert torch.rand(2, generator=torch.Generator(x.device)).device.index == 0
        mesh = nr.Mesh.icosphere(0)
        camera = nr.Camera.look_at((0.0, 0.0, -3.0)).to(x.device)
        alpha = nr.render(mesh.to(x.device), camera, 16, outputs="alpha").alpha
        assert alpha.any() and alpha.device == x.device
        torch.testing.assert_close(alpha, alpha.clone())
    assert x.device.index is None


def test_queries_of_cuda() -> None:
    with cuda_on_cpu(always=True):
        start, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        start.record()
        torch.cuda.synchronize()
        end.record()
        assert start.elapsed_time(end) >= 0
        assert torch.cuda.is_available() and torch.cuda.device_count() == 1
        with torch.cuda.device(0), torch.cuda.stream(torch.cuda.Stream()):
            torch.cuda.current_stream().synchronize()
        torch.cuda.manual_seed_all(3)
        assert torch.cuda.memory_allocated() == 0 and torch.cuda.get_device_properties(0).total_memory > 0
        assert torch.cuda.memory_summary() == ""
        torch.zeros(1, device="cuda").record_stream(torch.cuda.current_stream())
        net = torch.nn.DataParallel(torch.nn.Linear(3, 2), device_ids=[0]).cuda()
        assert net(torch.ones(4, 3, device="cuda")).shape == (4, 2) and "module.weight" in net.state_dict()


def test_moves_are_copies() -> None:
    """As between devices: what a program kept of an array or an image does not change later."""
    with cuda_on_cpu(always=True):
        array = np.zeros(3, np.float32)
        for tensor in (
            torch.from_numpy(array).cuda(),
            torch.as_tensor(array, device="cuda"),
            torch.from_numpy(array).to("cuda"),
        ):
            tensor += 1
        assert not array.any()
        image = torch.zeros(3, device="cuda")
        kept = [image.cpu(), image.to("cpu"), image.cpu().numpy()]
        image += 1
        assert not any(np.asarray(one).any() for one in kept)
        leaf = torch.zeros(3, device="cuda", requires_grad=True)
        assert leaf.cuda() is leaf and leaf.to("cuda") is leaf


def test_functions_of_a_program_run_backward_on_the_cpu() -> None:
    class Twice(torch.autograd.Function):
        @staticmethod
        def forward(ctx, x):
            return 2 * x

        @staticmethod
        def backward(ctx, grad):
            return grad * torch.full((), 2.0, device="cuda")

    with cuda_on_cpu(always=True):
        x = torch.ones(2, device="cuda", requires_grad=True)
        Twice.apply(x).sum().backward()
        [again] = torch.autograd.grad(Twice.apply(x).sum(), x)
    assert x.grad.tolist() == again.tolist() == [2, 2]


def test_files_and_defaults(tmp_path: Path) -> None:
    torch.save({"a": torch.ones(2)}, tmp_path / "a.pt")
    with cuda_on_cpu(always=True):
        for place in ("cuda", torch.device("cuda:0"), {"cpu": "cuda:0"}, lambda storage, _: storage.cuda(), None):
            assert torch.load(tmp_path / "a.pt", map_location=place)["a"].device.type == "cpu"
        torch.set_default_device("cuda")
        assert torch.zeros(1).device.type == "cpu"
        torch.set_default_device(None)


def test_nothing_remains() -> None:
    names = {name: getattr(torch.cuda, name) for name in ("is_available", "Event", "synchronize")}
    with pytest.raises(RuntimeError, match="stop"), cuda_on_cpu(always=True):
        raise RuntimeError("stop")
    assert all(getattr(torch.cuda, name) is value for name, value in names.items())


@pytest.mark.parametrize("installed", [False, True])
def test_the_installed_package_stands_unless_ours_is_asked_for(
    installed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if installed:
        (tmp_path / "nvdiffrast").mkdir()
        (tmp_path / "nvdiffrast" / "__init__.py").write_text("")
        (tmp_path / "nvdiffrast" / "torch.py").write_text("NAME = 'theirs'\n")
        monkeypatch.syspath_prepend(tmp_path)
    try:
        with stand_in():
            import nvdiffrast.torch as found
        assert (found is nr.nvdiffrast) is not installed
        with stand_in(always=True):
            import nvdiffrast.torch as found
        assert found is nr.nvdiffrast
    finally:
        for name in ("nvdiffrast", "nvdiffrast.torch"):
            sys.modules.pop(name, None)
