"""Small random scenes for the kernels, and how far float32 may stray from the float64 reference on them."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from torch import Tensor

from neural_renderer.raster.reference.operators import pixel_centres, sides
from tests.raster.reference.coverage import faces_at_pixels

FRONT = ("plain", "tiny", "huge", "outside", "point", "line", "copy", "flat", "speck", "sliver")
KINDS = (*FRONT, "crossing", "behind", "nan")
NEAR, FAR = 0.1, 10.0


def examples(count: int) -> settings:
    """Run the same examples each time, as many as the suite has time for."""
    phases = (Phase.explicit, Phase.generate, Phase.shrink)
    checks = list(HealthCheck)
    return settings(max_examples=count, deadline=None, derandomize=True, phases=phases, suppress_health_check=checks)


@dataclass(frozen=True)
class Scene:
    seed: int
    batch: int
    count: int
    height: int
    width: int
    two_sided: bool
    perspective: bool
    kinds: tuple[str, ...]

    @property
    def generator(self) -> torch.Generator:
        return torch.Generator().manual_seed(self.seed)

    @property
    def faces(self) -> Tensor:
        random = self.generator
        faces = torch.empty(self.batch, self.count, 3, 3)
        for image in faces:
            for f in range(self.count):
                kind = self.kinds[int(torch.randint(len(self.kinds), (), generator=random))]
                if kind == "crossing" and not self.perspective:
                    kind = "plain"  # see test_orthographic_face_through_the_camera_plane
                image[f] = _face(kind, image[:f], random)
        return faces

    def noise(self, *shape: int) -> Tensor:
        return torch.randn(*shape, generator=self.generator)


def _face(kind: str, before: Tensor, random: torch.Generator) -> Tensor:
    face = torch.rand(3, 3, generator=random) * torch.tensor([2.6, 2.6, 4]) + torch.tensor([-1.3, -1.3, 0.5])
    middle, arms = face.mean(0), face - face.mean(0)
    if kind == "tiny":
        return middle + 0.04 * arms
    if kind == "huge":
        return middle + arms * torch.tensor([100.0, 100, 1])
    if kind in ("speck", "sliver"):  # at the middle of the image, where a pixel's centre is if its sides are odd
        size = 10 ** -float(torch.rand((), generator=random) * 9 + 3)
        arms = (arms + 0.1 * arms[0]) * torch.tensor([size if kind == "speck" else 1, size, 0])
        return arms + face * torch.tensor([0, 0, 1])
    if kind == "outside":
        return face + torch.tensor([1.5, 0, 0])
    if kind == "point":
        return middle.expand(3, 3)
    if kind == "line":
        return torch.stack((face[0], face[1], (face[0] + face[1]) / 2))
    if kind == "copy" and len(before):
        return before[int(torch.randint(len(before), (), generator=random))]
    if kind == "flat":
        face[:, 2] = 2
    if kind in ("crossing", "behind"):
        number = 3 if kind == "behind" else int(torch.randint(1, 3, (), generator=random))
        face[:number, 2] *= -1
    if kind == "nan":
        face[0, 0] = float("nan")
    return face


def scenes(
    kinds: tuple[str, ...] = KINDS, most_faces: int = 30, side: int = 40, empty: bool = True
) -> st.SearchStrategy:
    low = 0 if empty else 1
    return st.builds(
        Scene,
        seed=st.integers(0, 2**31),
        batch=st.integers(low, 3),
        count=st.integers(low, most_faces),
        height=st.integers(1, side),
        width=st.integers(1, side),
        two_sided=st.booleans(),
        perspective=st.booleans(),
        kinds=st.lists(st.sampled_from(kinds), min_size=1, unique=True).map(tuple),
    )


def crosses(faces: Tensor, perspective: bool) -> Tensor:
    """Of faces [..., 3, 3], which lie partly behind the camera."""
    behind = faces[..., 2] <= 0
    return behind.any(-1) & ~behind.all(-1) & perspective


@dataclass(frozen=True)
class Doubt:
    """Bounds of float32 on each face of one image at each pixel, [F, H, W]."""

    possible: Tensor  # the face may be drawn here
    certain: Tensor  # the face must be drawn here, nearer things aside
    depth: Tensor
    error: Tensor  # of the depth


def doubt(faces: Tensor, height: int, width: int, two_sided: bool, perspective: bool) -> Doubt:
    """Of one image's faces [F, 3, 3]: where rounding may change whether a pixel is inside, and by how much its depth.

    A pixel's edge function is a difference of products of arms (corner minus centre), each rounded by 2^-24 a few
    times: it is in doubt below 1e-6 of the arms' lengths' product, a distance of some 1e-6 pixels for large faces.
    """
    found = faces_at_pixels(faces, height, width, perspective)
    faces = faces.double()
    arms = faces[:, None, None, :, :2] - torch.stack(pixel_centres(height, width), -1)[:, :, None]
    length = arms.norm(dim=-1)
    a, b = [1, 2, 0], [2, 0, 1]
    edge = arms[..., a, 0] * arms[..., b, 1] - arms[..., a, 1] * arms[..., b, 0]
    scale = faces[..., :2].abs().flatten(1).amax(1)[:, None, None, None] + 1
    open_edge = 1e-6 * length[..., a] * length[..., b] + 2e-7 * scale * (length[..., a] + length[..., b])
    z = faces[..., 2]
    spread = (z.amax(1) - z.amin(1))[:, None, None]
    error = 2e-6 * found.depth.abs() + spread * (open_edge.sum(-1) / edge.sum(-1).abs().clamp(min=1e-30)).clamp(max=1)
    crossing = crosses(faces, perspective)[:, None, None]
    near_edge = (edge.abs() <= open_edge).any(-1)
    # Behind the camera the corners' shares in space decide; the last bit of x and y changes them by up to 1e-5.
    shares = found.weights * (found.depth[..., None] / z[:, None, None])
    near_edge = torch.where(
        crossing, (shares.abs() <= 1e-5 * (1 + shares.abs().sum(-1, keepdim=True))).any(-1), near_edge
    )
    error = torch.where(crossing, 1e-4 * found.depth.abs() * (1 + found.depth.abs()), error)
    # Almost collinear corners: which side is seen is open too.
    whole = edge.sum(-1).abs()
    arm = (faces[:, a, :2] - faces[:, :, :2]).norm(dim=-1)
    thin = whole <= 1e-6 * (arm.amax(1)[:, None, None] + scale[..., 0]) * arm.amax(1)[:, None, None]
    side = sides(faces, perspective)[:, None, None]
    visible = (side > 0) | two_sided
    inside = found.inside & visible
    close = (edge * edge.sum(-1, keepdim=True).sign() >= -open_edge).all(-1) | crossing
    possible = inside | (near_edge & close & (visible | thin)) | (thin & close)
    finite = faces.isfinite().flatten(1).all(1)[:, None, None] & (~(z <= 0).all(1)[:, None, None] | (not perspective))
    return Doubt(possible & finite, inside & ~near_edge & ~thin, found.depth, error)


def condition(faces: Tensor, height: int, width: int) -> Tensor:
    """By how many 2^-24 the weights in faces [..., 3, 3] may be off: the products in them over the area, in pixels."""
    size = torch.tensor([width, height], dtype=torch.float64)
    corners = faces[..., :2].double() * size / 2
    a, b = corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :]
    area = (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]).abs()
    reach = corners.abs().flatten(-2).amax(-1) + max(height, width)
    return reach**2 / area
