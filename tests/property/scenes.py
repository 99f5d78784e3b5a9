"""Random scenes as no artist makes them: tiny, huge, thin and doubled faces, before, behind and through the camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from hypothesis import strategies as st
from torch import Tensor

import neural_renderer as nr

Pick = Callable[[Tensor], Tensor]

SHAPES = ("plain", "plain", "thin", "speck", "huge", "lattice", "one point", "around the camera")
CAMERAS = ("look_at", "along an axis", "orthographic", "mirrored", "projection", "weak_perspective")
LIGHTS = ("none", "lamp", "lamps", "harmonics")
RANGES = ((0.1, 100.0), (0.0, 1e6), (2.0, 3.0), (1e-3, 1e20))
DTYPES = (torch.float32, torch.float32, torch.float64, torch.float16, torch.bfloat16)


@dataclass(frozen=True)
class Scene:
    """Parts of a scene; its numbers follow from ``seed``."""

    seed: int
    batch: int
    vertices: int
    faces: int
    shape: str
    exponent: float  # of 10, for what is thin, tiny or huge
    camera: str
    light: str
    near_far: tuple[float, float]
    size: tuple[int, int]
    texels: int
    dtype: torch.dtype
    index_dtype: torch.dtype
    strided: bool
    anti_aliasing: bool
    two_sided: bool
    gradient: str

    @property
    def generator(self) -> torch.Generator:
        return torch.Generator().manual_seed(self.seed)

    @property
    def moderate(self) -> bool:
        """Whether no sum, product or square in its images leaves float32: nothing may be refused."""
        return self.shape != "huge" or self.exponent <= 6

    @property
    def options(self) -> dict[str, Any]:
        """Arguments of all functions that draw."""
        return {
            "near": self.near_far[0],
            "far": self.near_far[1],
            "anti_aliasing": self.anti_aliasing,
            "gradient": self.gradient,
        }

    def leaves(self, device: str) -> dict[str, Tensor]:
        """All tensors that a function may be given, each with a batch in front, asking for gradients."""
        random, b, f, t = self.generator, self.batch, self.faces, self.texels

        def noise(*shape: int) -> Tensor:
            return torch.randn(shape, generator=random)

        made = {
            "vertices": self._vertices(noise),
            "corners": self._corners(noise),
            "textures": noise(b, f, t, t, t, 3).sigmoid(),
            "light": noise(b, 2, f, 3).exp(),
            "background": noise(b, 3).sigmoid(),
            "picture": noise(b, 3, *self.size).sigmoid(),
            "eye": 2.7 * torch.nn.functional.normalize(noise(b, 3), dim=-1),
            "angle": 30 + 10 * noise(b).tanh(),
            "direction": noise(b, 3),
            "harmonics": noise(b, 9, 3),
            "shift": 0.1 * noise(b, 2),
            "uv": 3 * noise(f, 3, 2),
            "image": noise(4, 5, 3).sigmoid(),
            "colors": noise(f, 3, 3).sigmoid(),
            "attributes": noise(b, self.vertices, 4),
        }
        wide = {"eye", "angle", "direction", "harmonics", "shift", "background", "picture"}
        result = {}
        for name, value in made.items():
            value = value.to(device, torch.float32 if name in wide else self.dtype)
            if self.strided and value.dim() > 1:
                value = value.transpose(0, -1).contiguous().transpose(0, -1)
            result[name] = value.requires_grad_()
        return result

    def triangles(self, device: str) -> Tensor:
        """[F, 3]; some have a corner twice, some are others again, or turned over."""
        faces = torch.randint(self.vertices, (self.faces, 3), generator=self.generator)
        half = self.faces // 3
        if half:
            faces[half : 2 * half] = faces[:half]
            faces[2 * half : 3 * half] = faces[:half].flip(1)
        return faces.to(device, self.index_dtype)

    def _vertices(self, noise: Callable[..., Tensor]) -> Tensor:
        vertices, size = 0.7 * noise(self.batch, self.vertices, 3), 10**-self.exponent
        if self.dtype in (torch.float16, torch.bfloat16):
            size = max(size, 1e-4)
        if self.shape == "thin":
            vertices = vertices * torch.tensor([1.0, size, 1.0])
        elif self.shape == "speck":
            vertices = vertices * size
        elif self.shape == "huge":
            most = min(torch.finfo(self.dtype).max, torch.finfo(torch.float32).max)
            vertices = (vertices / size).clamp(-most, most)
        elif self.shape == "lattice":
            vertices = (2 * vertices).round() / 2
        elif self.shape == "one point":
            vertices = vertices[:, :1].expand(vertices.shape)
        elif self.shape == "around the camera":
            vertices = 5 * vertices
        return vertices

    def _corners(self, noise: Callable[..., Tensor]) -> Tensor:
        """[B, F, 3, 3] on the screen, at depths of 2 and a little, or behind."""
        corners = self._vertices(noise)[:, self.triangles("cpu").long()]
        depth = {"around the camera": 0.0, "huge": 0.0}.get(self.shape, 2.0)
        return corners + torch.tensor([0.0, 0.0, depth])

    def view(self, leaves: dict[str, Tensor], pick: Pick) -> nr.Camera:
        """The cameras of those images."""
        eye = pick(leaves["eye"])
        if self.camera == "along an axis":
            return nr.Camera.look_at(eye.new_tensor([0.0, 0.0, -2.7]).expand(eye.shape))
        if self.camera == "orthographic":
            return nr.Camera.look_at(eye, orthographic=True, scale=0.8)
        if self.camera == "mirrored":
            return nr.Camera.look(eye, -eye, mirrored=True, viewing_angle=25.0)
        camera = nr.Camera.look_at(eye, viewing_angle=pick(leaves["angle"]))
        if self.camera == "projection":
            lens = torch.tensor([[9.0, 0.1, 5.0], [0.0, 8.0, 4.0], [0.0, 0.0, 1.0]])
            turn = camera.rotation * eye.new_tensor([1.0, -1.0, 1.0])[:, None]  # y down, as in OpenCV
            back = eye.new_tensor([0.0, 0.0, 2.7]).expand(eye.shape)
            return nr.Camera.projection(lens, turn, back, (0.1, -0.02, 0.01, 0.01, 0.001), orig_size=(8, 10))
        if self.camera == "weak_perspective":
            turn = camera.rotation * eye.new_tensor([1.0, -1.0, 1.0])[:, None]
            return nr.Camera.weak_perspective(0.8, turn, pick(leaves["shift"]), distance=2.5)
        return camera

    def lights(self, leaves: dict[str, Tensor], pick: Pick) -> Any:
        lamp = nr.Light(0.4, 0.7, direction=pick(leaves["direction"]))
        harmonics = nr.SphericalHarmonicLight(pick(leaves["harmonics"]))
        return {"none": None, "lamp": lamp, "lamps": [lamp, harmonics], "harmonics": harmonics}[self.light]


def scenes() -> st.SearchStrategy[Scene]:
    return st.builds(
        Scene,
        seed=st.integers(0, 2**31),
        batch=st.integers(1, 3),
        vertices=st.integers(1, 30),
        faces=st.integers(0, 30),
        shape=st.sampled_from(SHAPES),
        exponent=st.floats(0, 38),
        camera=st.sampled_from(CAMERAS),
        light=st.sampled_from(LIGHTS),
        near_far=st.sampled_from(RANGES),
        size=st.tuples(st.integers(1, 24), st.integers(1, 24)),
        texels=st.integers(1, 3),
        dtype=st.sampled_from(DTYPES),
        index_dtype=st.sampled_from((torch.int32, torch.int64, torch.uint8)),
        strided=st.booleans(),
        anti_aliasing=st.booleans(),
        two_sided=st.booleans(),
        gradient=st.sampled_from(("nmr", "edge")),
    )
