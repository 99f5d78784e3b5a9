"""Cached kernels: damaged files are compiled again, a full disk gives an error message, leftovers are removed."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import warp as wp

import neural_renderer
from neural_renderer.raster.warp import kernel_cache, launch

# In a separate process with its own cache: a kernel that compiles in a second, damaged in several ways.
SCRIPT = """
import sys, warnings
from pathlib import Path
import torch, warp as wp
from neural_renderer.raster.warp import launch
wp.config.log_level = wp.LOG_WARNING

@wp.kernel(enable_backward=False)
def count(first: int, result: wp.array(dtype=float)):
    result[first + wp.tid()] = float(first + wp.tid() + 1)

def run():
    result = torch.zeros(3)
    launch.launch(count, 3, [wp.from_torch(result, return_ctype=True)], torch.device("cpu"))
    assert result.tolist() == [1, 2, 3]

def damage(suffix, change):
    [path] = Path(wp.config.kernel_cache_dir).glob("wp_*/*" + suffix)
    path.write_bytes(change(path.read_bytes()))
    forget()

def forget():
    count.module.unload()
    launch._ready.clear()
    launch._entries.clear()

run()
cases = [
    (".o", lambda data: data[:70] + bytes([data[70] ^ 1]) + data[71:]),  # an instruction; it would end the process
    (".meta", lambda data: b"{"),
    (".o", lambda data: b""),
    (".o", lambda data: data[: len(data) // 2]),
    (".o", lambda data: bytes(len(data))),
    (".o", lambda data: bytes(64) + data[64:]),
    (".meta", lambda data: b""),
]
for suffix, change in cases[:int(sys.argv[1])]:
    damage(suffix, change)
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        run()
    [warning] = found
    assert "wp_" in str(warning.message) and "compiled again" in str(warning.message), warning.message
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        forget()
        run()

damage(".o", lambda data: b"")
import shutil
shutil.rmtree = lambda *_, **__: None  # as of a folder of somebody else
try:
    run()
except OSError as error:
    assert "a damaged kernel" in str(error) and "; delete " in str(error) and "WARP_CACHE_PATH" in str(error), error
else:
    raise AssertionError
"""


@pytest.mark.parametrize("cases", [2, pytest.param(7, marks=pytest.mark.slow)])
def test_a_damaged_kernel_is_compiled_again(tmp_path: Path, cases: int) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    environment = {**os.environ, "WARP_CACHE_PATH": str(tmp_path / "cache")}
    command = [sys.executable, str(tmp_path / "script.py"), str(cases)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr


class Unknown:
    """A kernel of a module that no cache has."""

    module = SimpleNamespace(name="neural_renderer.none", get_module_identifier=lambda _: "wp_neural_renderer.none_0")


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache, for which nothing is to be compiled."""
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    monkeypatch.setattr(wp, "load_module", lambda *_, **__: pytest.fail("compiled"))
    return tmp_path


def test_a_full_disk_is_told_before_the_compiler_ends_the_process(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=70_000))
    monkeypatch.setattr(wp, "init", lambda: None)
    with pytest.raises(
        OSError, match=rf"{cache.name}: expected a folder .* No space left on device; set WARP_CACHE_PATH"
    ):
        launch.load_kernel(Unknown(), "cpu")


def test_folders_of_killed_processes_are_removed(cache: Path) -> None:
    old, new, other = (cache / f"wp_{name}_0123abc_p12_t34" for name in ("neural_renderer.a", "neural_renderer.b", "c"))
    kept = cache / "wp_neural_renderer.a_0123abc"
    for folder in (old, new, other, kept):
        folder.mkdir()
        (folder / "a.cpp").write_text("")
        if folder != new:
            os.utime(folder, (0, 0))
    kernel_cache._prepare()
    assert sorted(cache.iterdir()) == sorted((new, other, kept))


KEYS = """
import json, sys
import warp as wp
from neural_renderer.raster.ops import corners, visible_faces
from neural_renderer.raster.warp import launch
wp.config.log_level = wp.LOG_WARNING
wp.init()
keys = {}
for kernel in (corners._gather_corners, visible_faces._mark_pixels):
    launch._set_flags(kernel.module)
    keys[kernel.key] = [kernel.module.get_module_identifier(block) for block in (1, None)]
json.dump(keys | {"file": corners.__file__}, sys.stdout)
"""


@pytest.mark.slow
def test_the_key_of_a_kernel_is_its_code(tmp_path: Path) -> None:
    """A copy of the package at another path, with another comment, has the same keys; changed code has another."""
    own, copy = Path(neural_renderer.__file__).parent, tmp_path / "neural_renderer"
    shutil.copytree(own, copy, ignore=shutil.ignore_patterns("__pycache__", "*.pt"))
    commented, changed = (copy / "raster/kernels" / name for name in ("platform.h", "corners.h"))
    commented.write_text("// Another comment.\n" + commented.read_text().replace("};\n", "};  // the end\n"))
    changed.write_text(changed.read_text().replace(": NAN", ": 0.0f"))

    def keys(folder: Path) -> dict[str, Any]:
        environment = {**os.environ, "WARP_CACHE_PATH": str(tmp_path / "cache"), "PYTHONPATH": str(folder)}
        command = [sys.executable, "-c", KEYS]
        done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=folder, check=False)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    before, after = keys(own.parent), keys(tmp_path)
    assert before["file"] != after["file"]
    assert before["mark_pixels"] == after["mark_pixels"]
    assert not set(before["gather_corners"]) & set(after["gather_corners"])
