"""The commands of `reconstruct`: the list, their help, and wrong usage."""

from __future__ import annotations

from pathlib import Path

import pytest

from neural_renderer.apps import command_line as cli
from neural_renderer.apps.reconstruct.commands import COMMANDS
from neural_renderer.apps.reconstruct.commands.evaluate import method_labels
from neural_renderer.apps.reconstruct.evaluation.picture import WEIGHTS


def test_the_group_lists_its_commands(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["reconstruct"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in COMMANDS) and "From a folder of models to a prediction" in out


@pytest.mark.parametrize("name", COMMANDS)
def test_each_explains_itself(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["reconstruct", name, "--help"]) == 0
    assert f"Example: neural-renderer reconstruct {name}" in capsys.readouterr().out


@pytest.mark.parametrize(
    "arguments", [["nonsense"], ["dataset"], ["evaluate", "a.ckpt"], ["predict", "a.ckpt", "b.png"]]
)
def test_wrong_usage_is_2(arguments: list[str]) -> None:
    assert cli.main(["reconstruct", *arguments]) == 2


def test_the_network_of_the_package_is_called_shipped() -> None:
    assert method_labels([WEIGHTS, Path("a/best.ckpt"), Path("b/best.ckpt")]) == ["shipped", "a", "b"]
