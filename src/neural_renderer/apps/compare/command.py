"""`neural-renderer compare`: how different two mesh files look, with limits for scripts."""

from __future__ import annotations

import json

from ...meshes.uv_mesh import UVMesh
from ..common.checks import check_outputs
from ..common.command import choose_device, say
from ..common.pictures.outputs import GREY
from .comparison import compare
from .options import CompareOptions


def run(options: CompareOptions) -> int:
    """Compare two mesh files; return the exit code: 0, or 1 if a limit is not kept."""
    outputs = [] if options.output is None else [options.output]
    check_outputs(outputs, [options.first, options.second])
    device = choose_device(options.device)
    a, b = (UVMesh.load(path, GREY, options.allow_outside).to(device) for path in (options.first, options.second))
    found = compare(
        a,
        b,
        views=options.views,
        size=options.size,
        shading=options.shading,
        layers=options.layers,
        samples=options.samples,
        output=options.output,
    )
    if options.json:
        say(json.dumps(found.as_dict()))
    else:
        for line in (*found.table(), *map(str, outputs)):
            say(line)
    limits = {name: getattr(options, name) for name in ("psnr", "iou", "ms_ssim", "angle", "distance", "new_holes")}
    failures = found.failures(**limits)
    for sentence in failures:
        name, _, text = sentence.partition(":")
        say(f"--{name.replace('_', '-')}:{text}", "red")
    return int(bool(failures))
