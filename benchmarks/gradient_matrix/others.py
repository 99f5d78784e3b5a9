"""Estimators of other papers on the cases of the matrix, as far as they draw an output; None where they do not."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

import neural_renderer as nr
import neural_renderer.nvdiffrast as dr
from neural_renderer.raster.visibility.estimators import DrawnFaces, Estimator

from .cases import Case
from .measure import Draw, drawing


class Inside(Estimator):
    """Derivatives inside faces, and none of their outlines."""

    differentiates_inside = True

    def attach(
        self, image: Tensor | None, drawn: DrawnFaces, seams: bool = False, edge_hashes: object = None
    ) -> Tensor:
        """See `Estimator.attach`; for colours that are not averaged."""
        if image is None or drawn.halved:
            raise ValueError("image: expected colours, without anti-aliasing")
        return image.clone()


def opendr(case: Case, output: str) -> Draw:
    """Draw with OpenDR's gradient (Loper and Black, 2014)."""
    return drawing(case, output, "opendr")


def antialias(case: Case, output: str) -> Draw:
    """Draw with nvdiffrast's antialiasing (Laine et al., 2020), by this package, over derivatives inside faces."""
    faces = case.mesh.faces.int()
    inside = None if output == "alpha" else drawing(case, output, Inside())

    def draw(vertices: Tensor, camera: nr.Camera, size: int) -> Tensor:
        screen = camera(vertices)
        depth = screen[..., 2:]
        clip = torch.cat((screen[..., :2] * depth, 1.4 * depth - 2.4, depth), -1)  # near 1, far 6
        rast, _ = dr.rasterize(dr.RasterizeCudaContext(), clip, faces, (size, size))
        image = (rast[..., 3:] > 0).float() if inside is None else inside(vertices, camera, size).flip(2).movedim(1, 3)
        return dr.antialias(image.contiguous(), rast, clip, faces).flip(1).movedim(3, 1)

    return draw


def soft(case: Case, output: str) -> Draw | None:
    """Draw SoftRas' silhouettes (Liu et al., 2019), whose outlines fade over 0.3 pixels; small faces take too long."""
    if output != "alpha" or len(case.mesh.faces) > 400:
        return None

    def draw(vertices: Tensor, camera: nr.Camera, size: int) -> Tensor:
        parts = [
            nr.soft_silhouettes(nr.vertices_to_faces(one(vertices), case.mesh.faces), size, sigma=(0.6 / size) ** 2)
            for one in camera
        ]
        return torch.cat(parts)[:, None]

    return draw


OTHERS: dict[str, Callable[[Case, str], Draw | None]] = {
    "opendr": opendr,
    "nvdiffrast AA (ours)": antialias,
    "SoftRas": soft,
}
