"""DEODR: pip install deodr. It smooths outlines over a pixel outside them; seams and intersections have no gradient."""

from __future__ import annotations

import numpy as np
import torch
from deodr.differentiable_renderer import Scene2D
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from ..picture import Picture


class Deodr:
    """``Scene2D`` with a vertex for each corner, so that each has a colour, and the edges of the silhouette."""

    name, most_shifts, sigma = "DEODR", 10**6, 1.0

    def image(self, picture: Picture) -> Tensor:
        """Draw without a gradient."""
        return self.draw(picture, torch.zeros(3, picture.size, picture.size))[0]

    def draw(self, picture: Picture, pull: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        size, place = picture.size, picture.vertices[:, :2].numpy()
        ij = np.stack((place[:, 0] - 0.5, size - 0.5 - place[:, 1]), 1)  # y down, pixel centres at the integers
        kept, faces, flags, turned = _visible_sides(ij, picture.faces.numpy())
        order = np.where(turned[:, None], np.arange(2, -1, -1), np.arange(3))
        colors = np.take_along_axis(picture.colors.numpy()[kept], order[..., None], 1).reshape(-1, 3)
        count, flat = len(faces), faces.reshape(-1)
        corners = np.arange(3 * count, dtype=np.uint32).reshape(-1, 3)
        none = np.zeros(count, bool)
        scene = Scene2D(
            corners, np.zeros_like(corners), ij[flat], picture.vertices[:, 2].numpy()[flat], none, np.zeros((1, 2)),
            np.zeros(3 * count), colors, none, flags, size, size, 3, np.zeros((0, 0, 3)),
            background_color=np.array(picture.background), clockwise=True, backface_culling=True,
        )  # fmt: skip
        image, _ = scene.render(self.sigma)
        scene.clear_gradients()
        scene.render_backward(np.ascontiguousarray(pull.double().permute(1, 2, 0).numpy()))
        to_vertices = np.zeros((len(place), 3))
        np.add.at(to_vertices[:, :2], flat, scene.ij_b * [1, -1])
        own = np.empty((count, 3, 3))
        np.put_along_axis(own, order[..., None], scene.colors_b.reshape(-1, 3, 3), 1)
        to_colors = np.zeros(picture.colors.shape)
        to_colors[kept] = own
        return torch.from_numpy(image).permute(2, 0, 1), torch.from_numpy(to_vertices), torch.from_numpy(to_colors)


def adapters() -> list[Deodr]:
    """Make the adapter."""
    return [Deodr()]


def _visible_sides(ij: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, ...]:
    """Drop the far sides of closed surfaces, turn faces of open ones to the front, and flag edges of the outline.

    Returns:
        Indices of the kept faces [K], their vertices [K, 3], flags [K, 3] bool, and whether each is turned over [K].
    """
    a, b = ij[faces[:, 1]] - ij[faces[:, 0]], ij[faces[:, 2]] - ij[faces[:, 0]]
    front = a[:, 0] * b[:, 1] > a[:, 1] * b[:, 0]
    edges = np.sort(np.stack((faces, np.roll(faces, -1, 1)), -1), -1).reshape(-1, 2)
    keys = edges[:, 0] * len(ij) + edges[:, 1]
    _, name, count = np.unique(keys, return_inverse=True, return_counts=True)
    fronts = np.bincount(name, np.repeat(front, 3))
    alone = (count == 1)[name].reshape(-1, 3)
    folded = ((fronts != 0) & (fronts != count))[name].reshape(-1, 3)
    graph = coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(ij), len(ij)))
    part = connected_components(graph, directed=False)[1][faces[:, 0]]
    is_open = np.isin(part, part[alone.any(1)])
    # On a closed surface the front is the side that most of the picture's meshes turn outwards: counter-clockwise with
    # y up, so clockwise here.
    outward = ~front
    kept = np.nonzero(is_open | outward)[0]
    turned = ~front[kept]  # Scene2D draws the faces that are clockwise with y down
    ours = np.where(turned[:, None], faces[kept][:, ::-1], faces[kept])
    flags = (alone | folded)[kept]
    # Edge k runs from corner k to the next; in a turned face, the order of edges is reversed, too.
    flags = np.where(turned[:, None], flags[:, [1, 0, 2]], flags)
    return kept, ours.astype(np.uint32), np.ascontiguousarray(flags), turned
