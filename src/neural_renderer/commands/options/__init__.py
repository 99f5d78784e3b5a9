"""What can be typed after each command of `neural-renderer`, without what it does: help needs no torch.

The modules are named as those of `commands` that do the work, and ``RenderOptions`` are the options of ``Render``.
"""
