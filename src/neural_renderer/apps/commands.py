"""The list of commands: name → summary, and the module whose function ``run(options)`` returns the exit code.

The options of a command called name are the class ``NameOptions`` in `options`, beside the module or its folder
`commands`. Its method ``validate()``, if there is one, raises an error for options, paths and missing libraries. The
module `options` does not import torch, so that help and errors appear immediately. It may have a function
``parse(arguments, prog)`` that makes the options, in place of tyro's parser. The module of a command is imported when
the command runs. A module called `commands` is a group, which lists its own commands.
"""

from typing import NamedTuple


class Command(NamedTuple):
    """A command of the command line."""

    summary: str
    module: str
    """Dotted name below `neural_renderer.apps`."""

    @property
    def options(self) -> str:
        """Module of the options."""
        return f"{self.module.partition('.')[0]}.options"


COMMANDS = {
    "render": Command("Draw a mesh file as a picture or a turntable.", "render.command"),
    "compare": Command("Measure how different two meshes look.", "compare.command"),
    "info": Command("Show versions and devices, and check that rendering works.", "info.command"),
    "fit": Command("Recover a textured mesh from photographs or other images.", "fit.commands.fit"),
    "finish": Command("Make a light mesh that looks like a heavy one.", "finish.command"),
    "pose": Command("Find the pose of a known object in pictures.", "pose.command"),
    "dataset": Command("Draw views of many models.", "many.commands.dataset"),
    "batch": Command("Run fit, style, dream or finish many times.", "many.commands.batch"),
    "reconstruct": Command("Reconstruct a mesh from a single picture.", "reconstruct.commands"),
    "style": Command("Transfer the style of a painting to a mesh.", "edit.command"),
    "dream": Command("Apply DeepDream to a mesh.", "edit.command"),
    "view": Command("Show meshes, results and records in the browser.", "view.command"),
    "run": Command("Run a program for nvdiffrast or PyTorch3D without CUDA.", "run.command"),
    "demo": Command("Draw a turntable, and fit a sphere to a duck.", "demo.command"),
}
