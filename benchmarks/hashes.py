"""Hashes of outputs and gradients of the benchmark scenes: ``python -m benchmarks.hashes``.

Run it before and after a change of kernels. On the CPU equal hashes mean results that are equal to the bit, for any
number of threads. Processors with other vector instructions may round differently, so compare on one machine.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator

import torch
from torch import Tensor

import neural_renderer as nr

from .scenes import noisy_icospheres

# (images, side, icosphere level, both sides)
CASES = [(64, 128, 3, False), (8, 256, 3, False), (1, 512, 6, False), (4, 448, 4, True), (1, 1024, 1, False)]


def hash_of(*tensors: Tensor) -> str:
    """Hash the bytes of tensors."""
    result = hashlib.sha256()
    for tensor in tensors:
        result.update(tensor.detach().contiguous().numpy().tobytes())
    return result.hexdigest()[:16]


def rows() -> Iterator[tuple[str, str]]:
    """Draw each scene, forward and backward: its name, and the hash of images and gradients."""
    for images, side, level, two_sided in CASES:
        for gradient in ("nmr", "edge", "opendr"):
            if gradient == "opendr" and images * side * side > 10**6:
                continue  # plain torch, which takes gigabytes
            for outputs in (("alpha",), ("rgb",), ("rgb", "alpha", "depth")):
                for anti_aliasing in (False, True):
                    name = f"{images} × {side}², level {level}, {gradient}, {' '.join(outputs)}"
                    options = {"outputs": outputs, "two_sided": two_sided, "anti_aliasing": anti_aliasing}
                    yield name + ", smooth" * anti_aliasing, _cubes(images, side, level, gradient, options)
    for shading in ("flat", "smooth", "pbr"):
        for gradient in ("nmr", "edge"):
            for layers in (1, 2):
                options = {"shading": shading, "gradient": gradient, "layers": layers}
                yield f"UVMesh, {shading}, {gradient}, {layers} layers", _texture_image(options)


def _cubes(images: int, side: int, level: int, gradient: str, options: dict) -> str:
    faces = noisy_icospheres(images, level).requires_grad_()
    random = torch.Generator().manual_seed(1)
    cubes = torch.rand(1, faces.shape[1], 3, 3, 3, 3, generator=random).requires_grad_()
    light = torch.rand(1, 2, faces.shape[1], 3, generator=random).requires_grad_()
    leaves = [faces, cubes, light] if "rgb" in options["outputs"] else [faces]
    drawn = nr.rasterize_images(faces, side, textures=cubes, light=light, gradient=gradient, **options)
    return _hash(list(drawn), leaves)


def _texture_image(options: dict) -> str:
    vertices, faces = nr.icosphere(4)
    uv = vertices[:, :2] * 0.5 + 0.5
    vertices.requires_grad_()
    random = torch.Generator().manual_seed(2)
    image = torch.rand(64, 64, 3, generator=random).requires_grad_()
    glass = (nr.Material("glass", opacity=0.5, alpha_mode="BLEND", double_sided=True),)
    mesh = nr.UVMesh(vertices, faces, uv, image, materials=glass)
    camera = nr.Camera.look_at(eye=torch.tensor([[0.4, 0.6, -2.7], [2.0, -0.5, -1.9]]))
    lights = [nr.Light(0.3, 0.5), nr.PointLight((1.0, 2.0, -2.0))] if options["shading"] != "flat" else nr.Light()
    drawn = nr.render(mesh, camera, 128, light=lights, **options)
    return _hash(list(drawn)[:1], [vertices, image])


def _hash(images: list[Tensor | None], leaves: list[Tensor]) -> str:
    shown = [image for image in images if image is not None]
    random = torch.Generator().manual_seed(3)
    loss = sum((image * torch.randn(image.shape, generator=random)).sum() for image in shown)
    return hash_of(*shown, *torch.autograd.grad(loss, leaves, allow_unused=False))


if __name__ == "__main__":
    for name, value in rows():
        print(f"{value}  {name}", flush=True)
