"""The fuzzers, each for a few inputs that are always the same, and all inputs that once failed."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from tests.fuzz.fuzzers import FUZZERS, keep, kept

FEW = {"videos": 4, "calls": 40}
OLD = [(name, file, data) for name in FUZZERS for file, data in kept(name)]


@pytest.mark.parametrize("name", FUZZERS)
def test_some_inputs(name: str, tmp_path: Path) -> None:
    fuzzer = FUZZERS[name](tmp_path)
    rng = random.Random(0)
    try:
        for _ in range(FEW.get(name, 10)):
            fuzzer.run(*fuzzer.draw(rng))
    finally:
        fuzzer.close()


@pytest.mark.parametrize(("name", "file", "data"), OLD, ids=[f"{name}-{file}" for name, file, _ in OLD])
def test_inputs_that_once_failed(name: str, file: str, data: bytes, tmp_path: Path) -> None:
    fuzzer = FUZZERS[name](tmp_path)
    try:
        fuzzer.run(file, data)
    finally:
        fuzzer.close()


def test_inputs_follow_from_the_seed(tmp_path: Path) -> None:
    """So that a failure of another machine can be found again by its seed."""
    for name in ("obj", "calls"):
        (tmp_path / name).mkdir()
        fuzzer = FUZZERS[name](tmp_path / name)
        first, second = ([fuzzer.draw(rng) for _ in range(5)] for rng in (random.Random(7), random.Random(7)))
        assert first == second and len(set(first)) == 5


def test_a_failure_is_kept(tmp_path: Path) -> None:
    path = keep("obj", "in/a.obj", b"v", tmp_path)
    assert path.read_bytes() == b"v" and path.relative_to(tmp_path).parts[0] == "obj"
    assert keep("obj", "in/a.obj", b"v", tmp_path) == path
