"""Mitsuba 3 with projective sampling of silhouettes: pip install mitsuba; LLVM 19 or CUDA. Seams have no gradient."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import torch
from torch import Tensor

from ..picture import Picture

mi.set_variant("llvm_ad_rgb")
mi.set_log_level(mi.LogLevel.Error)


class Mitsuba:
    """A mesh that emits its colours, in front of a perspective camera, with 16 samples of a pixel."""

    name, most_shifts, samples = "Mitsuba 3", 16, 16

    def __init__(self) -> None:
        self.seed = 0

    def draw(self, picture: Picture, pull: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        vertices, colors = (t.detach().clone().requires_grad_() for t in (picture.vertices, picture.colors))
        # The camera sees x / Z and y / Z in [-1, 1]; 1 / Z is linear on the screen, as depth is.
        far = 1 / (1.2 - 0.1 * vertices[:, 2:])
        place = (vertices[:, :2] * 2 / picture.size - 1) * torch.tensor([-1.0, 1.0]) * far
        points = torch.cat((place, far), 1)
        kind, own = _attribute(picture, colors)
        scene, params = self._scene(picture, points, kind, own)
        keys = "mesh.vertex_positions", f"mesh.{kind}"
        for key in keys:
            dr.enable_grad(params[key])
        params.update()
        image = mi.render(scene, params, spp=self.samples, seed=self.seed)
        self.seed += 1
        weight = mi.TensorXf(np.ascontiguousarray(pull.float().permute(1, 2, 0).numpy()))
        dr.backward(dr.sum((image * weight).array))
        found = [torch.from_numpy(np.array(dr.grad(params[key])).reshape(-1, 3)).double() for key in keys]
        to_vertices, to_colors = torch.autograd.grad((points, own), (vertices, colors), found)
        return torch.from_numpy(np.array(image)).permute(2, 0, 1), to_vertices, to_colors

    def _scene(self, picture: Picture, points: Tensor, kind: str, colors: Tensor):  # type: ignore[no-untyped-def]
        properties = mi.Properties()
        glow = {"type": "area", "radiance": {"type": "mesh_attribute", "name": kind}}
        properties["emitter"] = mi.load_dict(glow)
        black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
        properties["bsdf"] = mi.load_dict({"type": "twosided", "bsdf": black})
        mesh = mi.Mesh("mesh", vertex_count=len(points), face_count=len(picture.faces), props=properties)
        mesh.add_attribute(kind, 3, colors.detach().float().flatten().numpy())
        inside = mi.traverse(mesh)
        inside["vertex_positions"] = points.detach().float().flatten().numpy()
        inside["faces"] = _to_the_camera(points.detach(), picture.faces).flatten().numpy().astype(np.uint32)
        inside.update()
        film = {"type": "hdrfilm", "width": picture.size, "height": picture.size, "rfilter": {"type": "box"}}
        film |= {"sample_border": True}
        at = mi.ScalarTransform4f().look_at([0, 0, 0], [0, 0, 1], [0, 1, 0])
        background = {"type": "constant", "radiance": {"type": "rgb", "value": list(picture.background)}}
        scene = mi.load_dict({
            "type": "scene",
            "integrator": {"type": "direct_projective", "sppi": 0},
            "sensor": {"type": "perspective", "fov": 90, "near_clip": 0.01, "to_world": at, "film": film},
            "mesh": mesh,
            "background": background,
        })  # fmt: skip
        return scene, mi.traverse(scene)


def adapters() -> list[Mitsuba]:
    """Make the adapter."""
    return [Mitsuba()]


def _attribute(picture: Picture, colors: Tensor) -> tuple[str, Tensor]:
    """Give colours to vertices if those of the corners agree there; else one to each face."""
    flat, where = colors.reshape(-1, 3), picture.faces.reshape(-1)
    one = torch.zeros(len(picture.vertices), dtype=torch.int64).scatter_(0, where, torch.arange(len(where)))
    at_vertices = flat[one]
    if torch.equal(at_vertices[where], flat):
        # Each corner's share of its vertex: the gradient goes to one of them.
        return "vertex_color", at_vertices
    return "face_color", colors.mean(1)


def _to_the_camera(points: Tensor, faces: Tensor) -> Tensor:
    """Turn over each open surface that faces away, as a whole: an emitter shines on its front."""
    label = torch.arange(len(points))
    while True:
        least = label[faces].amin(1)[:, None].expand(-1, 3).reshape(-1)
        new = label.scatter_reduce(0, faces.reshape(-1), least, "amin")
        if torch.equal(new, label):
            break
        label = new
    part = label[faces[:, 0]]
    away = torch.linalg.det(points[faces]) > 0
    edges = torch.stack((faces, faces.roll(-1, 1)), -1).reshape(-1, 2).sort(1).values
    _, name, count = edges.unique(dim=0, return_inverse=True, return_counts=True)
    alone = (count[name] == 1).view(-1, 3).any(1)
    closed = ~torch.isin(part, part[alone])
    # Closed surfaces come with their outsides counter-clockwise, and the mirroring above turned the handedness.
    turn = torch.where(closed, False, away)
    return torch.where(turn[:, None], faces.flip(1), faces)
