"""Limits of memory: the error says how many pixels would fit."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

import neural_renderer as nr
from neural_renderer.raster import settings


@pytest.fixture
def system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Files of a system whose containers have no limits yet."""
    monkeypatch.setattr(settings, "_CGROUPS", tmp_path / "cgroup")
    limits = {kind: (tmp_path / f"v{kind}", name) for kind, (_, name) in settings._LIMITS.items()}
    monkeypatch.setattr(settings, "_LIMITS", limits)
    return tmp_path


def limit(system: Path, kind: str, group: str, value: str) -> None:
    folder, name = settings._LIMITS[kind]
    (folder / group).mkdir(parents=True, exist_ok=True)
    (folder / group / name).write_text(value)


@pytest.mark.parametrize(("kind", "line"), [("", "0::/a/b"), ("memory", "4:memory:/a/b")])
def test_the_least_limit_of_all_containers_around_counts(system: Path, kind: str, line: str) -> None:
    whole = settings._machine_memory()
    (system / "cgroup").write_text(f"9:cpu:/else\n{line}\n")
    assert settings._machine_memory() == whole
    limit(system, kind, "a/b", "max\n")
    assert settings._machine_memory() == whole
    limit(system, kind, "a", "3000000\n")
    limit(system, kind, "", "4000000\n")
    assert settings._machine_memory() == 3000000
    limit(system, kind, "a/b", "2000000\n")
    assert settings._machine_memory() == 2000000


def test_too_many_pixels_say_what_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(settings, "_machine_memory", lambda: 2**31)
    corners = torch.rand(1, 2, 3, 3)
    # A pixel of a silhouette counts 44 bytes.
    with pytest.raises(ValueError, match=r"2\.0 GiB of cpu, got 1 of 10000 x 10000 .* 4\.1 GiB; 48 million"):
        nr.rasterize_images(corners, 10_000, outputs="alpha", anti_aliasing=False)
