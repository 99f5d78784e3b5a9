"""Tensors on devices without kernels: images and gradients come back on their device, computed on the CPU."""

from __future__ import annotations

import pytest

from tests.other_device import available
from tests.programs import run_python

# A process of its own, because torch keeps the device.
PROGRAM = """
import warnings
import torch
import neural_renderer as nr
from tests import other_device

other_device.register()
ball = nr.Mesh.icosphere(1)
random = torch.Generator().manual_seed(0)
cubes, uv, picture = (torch.rand(*shape, generator=random) for shape in ((80, 2, 2, 2, 3), (80, 3, 2), (8, 8, 3)))
lamps = [nr.Light(), nr.PointLight((-1.0, 2.0, 2.0), intensity=5.0)]
lens = torch.tensor([[20.0, 0, 8], [0, 20, 8], [0, 0, 1]])

def drawn(device, vertices, camera, kind, **options):
    faces = ball.faces.to(device)
    if kind == "cubes":
        mesh = (vertices, faces, cubes.to(device))
    else:
        mesh = nr.UVMesh(vertices, faces, uv.to(device), image=picture.to(device))
    return nr.render(mesh, camera, 16, **options)

def shaded(device, vertices, camera, kind):
    fragments = nr.fragments((vertices, ball.faces.to(device)), camera, 16)
    return {"image": fragments.composite(fragments.interpolate(vertices), background=0.5)}

def results(device, work, camera, *arguments, **options):
    vertices = ball.vertices.clone().to(device).requires_grad_()
    images = work(device, vertices, camera, *arguments, **options)
    images = images if isinstance(images, dict) else vars(images)
    loss = 0
    for image in images.values():
        if image.is_floating_point():
            weights = torch.rand(image.shape, generator=torch.Generator().manual_seed(1))
            loss = loss + (image * weights.to(device)).sum()
    loss.backward()
    return {**images, "gradient": vertices.grad}

def check(*arguments, **options):
    there = results("other", *arguments, **options)
    here = results("cpu", *arguments, **options)
    for name, image in there.items():
        assert image.device.type == "other", (arguments, options, name)
        torch.testing.assert_close(image.cpu(), here[name], rtol=1e-4, atol=1e-4)

camera = nr.Camera.look_at(torch.tensor([[0.0, 1.0, -2.5]]))
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    check(drawn, camera, "cubes", gradient="nmr")
    check(drawn, camera, "cubes")
messages = [str(each.message) for each in caught if each.category is UserWarning]
assert messages == [
    "tensors: there are no kernels for the device other:0; images and gradients are computed on the CPU"
], messages
assert caught[0].filename == __file__

check(drawn, camera, "cubes", gradient="opendr")
check(drawn, camera, "cubes", tile=16)
check(drawn, camera, "image")
check(drawn, camera, "image", shading="smooth", light=lamps)
check(drawn, camera, "image", layers=2)
check(drawn, camera, "image", outputs=("normal", "position", "uv", "face_index", "barycentric"))
check(shaded, camera, "cubes")

corners = nr.vertices_to_faces(ball.vertices[None].to("other"), ball.faces.to("other"))
assert nr.rasterize_images(corners, 16, outputs="alpha").alpha.device.type == "other"

nr.fall_back_to_cpu(False)
for call in (lambda: results("other", drawn, camera, "cubes"), lambda: nr.rasterize_silhouettes(corners, 16)):
    try:
        call()
    except ValueError as error:
        assert "expected the CPU or an NVIDIA GPU, got device other:0" in str(error), error
    else:
        raise SystemExit("expected an error")
"""


@pytest.mark.skipif(not available(), reason="this torch makes no devices from Python")
def test_everything_is_drawn_there(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(PROGRAM)
    done = run_python(script)
    assert done.returncode == 0, done.stderr[-3000:]
