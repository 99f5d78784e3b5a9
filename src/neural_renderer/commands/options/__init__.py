"""Options of the subcommands, which `--help` shows. These modules do not import torch, so that help starts fast.

The module `options.render` with the class `RenderOptions` belongs to the command `commands.render`, and so on.
"""
