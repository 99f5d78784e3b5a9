"""Indices that change between forward and backward, by ways that autograd does not see: no wrong address is used.

The calls run in a process of their own, which a wrong address would end.
"""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
import sys, torch, neural_renderer as nr, neural_renderer.nvdiffrast as dr


def change_and_return(name, way, value):
    clip = torch.tensor([[[-0.8, -0.8, 0, 1], [0.8, -0.8, 0, 1], [-0.8, 0.8, 0, 1]]], requires_grad=True)
    start = torch.tensor([[0, 1, 2]], dtype=torch.int32)
    faces = start.clone() if way == "data" else torch.from_numpy(start.numpy().copy())
    view = faces.numpy()
    rast, change = dr.rasterize(dr.RasterizeCudaContext(), clip, faces, [8, 8])
    values, image = torch.rand(1, 3, 3, requires_grad=True), torch.rand(1, 8, 8, 3, requires_grad=True)
    if name == "rasterize":
        out = rast[..., :2].sum() + change.sum()
    elif name == "interpolate":
        out = dr.interpolate(values, rast, faces, change, "all")[0].sum()
    elif name == "antialias":
        out = dr.antialias(image, rast.detach(), clip, faces).square().sum()
    else:
        mesh = clip[0, :, :3], faces, torch.ones(1, 2, 2, 2, 3)
        out = nr.render(mesh, nr.Camera.look_at((0, 0, -2.7)), 32, gradient=name).rgb.sum()
    faces.data.fill_(value) if way == "data" else view.fill(value)
    out.backward()


for call in sys.argv[1:]:
    for value in (2**30, -(2**30), 3, -1):
        change_and_return(*call.split(":"), value)
    print(call, flush=True)
"""
CALLS = [
    f"{name}:{way}" for way in ("data", "numpy") for name in ("antialias", "rasterize", "interpolate", "nmr", "edge")
]


def test_backward_reads_what_it_has_checked() -> None:
    run = subprocess.run([sys.executable, "-c", PROGRAM, *CALLS], capture_output=True, text=True, timeout=600)
    assert run.stdout.split() == CALLS, (run.returncode, run.stderr[-500:])
