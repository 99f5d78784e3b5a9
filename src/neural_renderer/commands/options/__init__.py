"""Options of the subcommands and their help texts. These modules do not import torch, so that `--help` is fast.

The module `options.render` with the class `RenderOptions` belongs to the command `commands.render`, and so on.
"""
