"""Fixtures of all tests."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import torch

from tests.paths import DATA

# In deterministic mode torch refuses products of matrices on CUDA without this.
os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")

if TYPE_CHECKING:
    from tests.native.kernels import NativeKernels


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real files beside the project; a test that needs it is skipped where it is missing."""
    folder = Path(__file__).resolve().parents[2] / "shared"
    if not (folder / "data").is_dir():
        pytest.skip(f"the folder of test data {folder / 'data'} is missing")
    return folder


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--emulated-cuda",
        choices=["plain", "races"],
        help="run the CUDA code of all kernels on a processor; 'races' also fails tests with unordered accesses",
    )
    parser.addoption(
        "--device",
        choices=["cpu", "cuda"],
        help="tests of one device; cuda: those that take a device, and those that need CUDA beside the CPU, on a GPU; "
        "with --emulated-cuda those that take a device, with tensors that say they are on one",
    )
    parser.addoption(
        "--sanitizer",
        choices=["none", "address", "thread"],
        default="none",
        help="run the C++ kernels as this machine's compiler builds them with a sanitizer; see `make test-native`",
    )


@pytest.fixture(autouse=True)
def interrupts() -> None:
    """Let tests press Ctrl-C where a shell started them in the background, which ignores it."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def emulated_modules(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of translated kernels; `make test-cuda-emulated` names one that its runs share."""
    folder = os.environ.get("EMULATED_MODULES")
    return Path(folder) if folder else tmp_path_factory.mktemp("emulated_cuda")


@pytest.fixture(autouse=True)
def emulated_cuda(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """With --emulated-cuda every launch of a test runs CUDA's code; with --device cuda its tensors emulate CUDA's."""
    mode = request.config.getoption("--emulated-cuda")
    if mode is None:
        yield
        return
    from neural_renderer.base import validate
    from tests.cuda_emulation.device import EmulatedDevice
    from tests.cuda_emulation.tensors import Gpu

    tensors: contextlib.AbstractContextManager[object] = contextlib.nullcontext()
    if request.config.getoption("--device") == "cuda":
        tensors = Gpu()
        # Values of torch's own kinds of tensors alone are checked.
        monkeypatch.setattr("neural_renderer.base.validate.values_are_checked", lambda value: validate._check_values)
    with EmulatedDevice(request.getfixturevalue("emulated_modules"), mode) as device, tensors:
        yield
    races = {kernel: sums[0] for kernel, sums in device.measured.items() if mode == "races" and sums[0]}
    assert not races, f"unordered accesses to memory: {races}"
    assert not device.unordered, f"sums in any order in deterministic mode: {device.unordered}"


@pytest.fixture(scope="session")
def sanitized_kernels(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> NativeKernels:
    """The kernels of the C++ headers with the sanitizer of --sanitizer."""
    from tests.native.compiler import environment
    from tests.native.kernels import NativeKernels

    sanitizer = request.config.getoption("--sanitizer")
    for name, value in environment(sanitizer).items():
        if os.environ.get(name) != value:
            raise pytest.UsageError(f"--sanitizer {sanitizer}: expected {name}={value}, as in `make test-native`")
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent  # which all processes of a run share
    # Tasks of the address sanitizer run one after the other, so that its message names the first wrong access.
    return NativeKernels(folder, sanitizer, threads=4 if sanitizer == "thread" else 1)


@pytest.fixture(autouse=True)
def native_kernels(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """With --sanitizer every launch of a kernel of a C++ header runs that kernel with the sanitizer."""
    sanitizer = request.config.getoption("--sanitizer")
    if sanitizer == "none":
        return
    kernels = request.getfixturevalue("sanitized_kernels")
    monkeypatch.setattr("neural_renderer.raster.warp.launch.emulator", kernels.launch)
    if sanitizer == "thread":  # rows and bands for four threads, so that small images have several tasks
        monkeypatch.setattr("neural_renderer.raster.warp.layout._ROWS", 2)  # a block of samples has one task
        monkeypatch.setattr("neural_renderer.raster.warp.layout._ENOUGH_PIXELS", 1)
        monkeypatch.setattr("torch.get_num_threads", lambda: 4)


@pytest.fixture(autouse=True)
def old_names_on_the_cpu(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Old names make tensors on the CPU, where a test can compare them, unless it asks for CUDA among old programs."""
    device = getattr(getattr(request.node, "callspec", None), "params", {}).get("device")
    if device != "cuda" or "compat" not in request.path.parts:
        monkeypatch.setattr("neural_renderer.base.constants.old_device", lambda: torch.device("cpu"))


@pytest.fixture(autouse=True)
def values_are_judged_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let each call on CUDA wait for its own checks of values, so that tests see its errors."""
    monkeypatch.setattr("neural_renderer.base.validate._wait", True)


@pytest.fixture
def deterministic() -> Iterator[None]:
    """Sums in one order on every device, for tests that compare gradients bit for bit."""
    before = torch.are_deterministic_algorithms_enabled()
    torch.use_deterministic_algorithms(True)
    yield
    torch.use_deterministic_algorithms(before)


@pytest.fixture(params=["here", "all"])
def nasty(request: pytest.FixtureRequest) -> Path:
    """The folder of meshes that are hard to read: the small ones of this repository, and all of them beside it."""
    if request.param == "here":
        return DATA / "nasty"
    return request.getfixturevalue("shared") / "data" / "meshes" / "nasty"


def pytest_configure(config: pytest.Config) -> None:
    """Refuse --device cuda without a GPU, and share the processors among the processes of a run.

    These also share them with the programs that tests start. Otherwise the threads of each wait for those of the
    others, and small operations take many times as long.
    """
    if config.getoption("--device") == "cuda" and not (torch.cuda.is_available() or _emulates(config)):
        raise pytest.UsageError("--device cuda: expected an NVIDIA GPU that torch can use, found none")
    processes = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    if processes > 1:
        threads = max(1, torch.get_num_threads() // processes)
        torch.set_num_threads(threads)
        os.environ.setdefault("OMP_NUM_THREADS", str(threads))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Import the tests without garbage collection, as modules stay; later collections leave them out, too."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep the tests of the device that --device asks for; the others run on the CPU."""
    wanted = config.getoption("--device")
    left_out = [item for item in items if wanted not in (None, device_of(item))]
    items[:] = [item for item in items if wanted in (None, device_of(item))]
    config.hook.pytest_deselected(items=left_out)


def _emulates(config: pytest.Config) -> bool:
    return config.getoption("--emulated-cuda") is not None and config.getoption("--device") == "cuda"


def device_of(item: pytest.Item) -> str:
    """Name the device that a test needs: its parameter, CUDA if it compares two of them, or else the CPU."""
    by_default = "cuda" if item.get_closest_marker("two_devices") else "cpu"
    return str(getattr(getattr(item, "callspec", None), "params", {}).get("device", by_default))


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip what needs a GPU where there is none. Seed random numbers, so that tests do not depend on their order."""
    if item.get_closest_marker("two_devices") and not torch.cuda.is_available():
        pytest.skip("needs a GPU beside the CPU")
    torch.manual_seed(0)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Every test that takes ``device`` runs on the CPU, and on CUDA where there is one; old programs always on both."""
    if "device" in metafunc.fixturenames:
        old = "compat" in metafunc.definition.path.parts
        on_cuda = torch.cuda.is_available() or old or _emulates(metafunc.config)
        metafunc.parametrize("device", ["cpu", "cuda"] if on_cuda else ["cpu"])
