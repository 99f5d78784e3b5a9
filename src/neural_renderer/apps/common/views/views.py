"""Posed images: cameras with silhouettes and photos, the input of a fit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from ....base import validate
from ....camera import Camera
from ....camera.camera import with_extrinsics, world_origin
from ....meshes.mesh import Mesh
from ....meshes.uv_mesh import UVMesh
from ....optim import metrics
from ....raster import Images
from ....raster.fragments import Fragments
from ....rendering.deferred import fragments
from ....rendering.forward import render
from ..adjustable import generator
from ..options import SIZE

VIEWS_PER_PASS = 8
"""Views that are drawn together, which limits memory."""
WHOLE = 0.999
"""Share of a pixel that counts as all of it, because of rounding."""
# A pixel covered by 2 of 4 samples has alpha 0.5, which becomes 0.502 in a file of eight bits. Both must be inside.
_INSIDE = 0.49
_REACH = 0.7  # half the side of the cube that the first pass searches, relative to the distance of the nearest camera
_NEAR = 0.01  # nearest surface that is drawn, in halves of the object's longest side


@dataclass(frozen=True, eq=False)
class Views:
    """Posed images: N cameras, the silhouette of the object in each, and its colours if they are known.

    Attributes:
        camera: N cameras.
        masks: [N, H, W] float32 in [0, 1], silhouettes: 1 where the object covers a pixel.
        photos: [N, 3, H, W] float32 in [0, 1], RGB multiplied by the mask; or None.
        region: Where the object is, if that is known: centre [3] and half the side of a cube, in the world; or None.
        normals: [N, 3, H, W] float32, unit normals in world space, multiplied by the mask; or None.
        depth: [N, H, W] float32, depth along the viewing axis in world units, 0 where it is not known; or None.
        gains: [N, 3] float32, factors of red, green and blue of each photo, which `draw` applies; or None.
        scenes: [N, 3, H, W] float32 in [0, 1], RGB of whole photographs, with what is around the object; or None.
        backgrounds: [N, 3, H, W] float32, the colours behind the object in each of them, NaN where they are not known;
            or None. With both, colours locate the outline, and masks have a small weight: see `DetailFit`.

    Raises:
        TypeError, ValueError: A type or shape does not fit, there are no views, or a mask is empty.

    Example:
        >>> from neural_renderer.apps.fit import Views
        >>> eyes = nr.get_points_from_angles(3.0, 20.0, torch.arange(6) * 60.0)
        >>> views = Views.of(nr.Mesh.icosphere(2), nr.Camera.look_at(eyes, viewing_angle=25), size=32)
        >>> len(views), views.size, views.photos.shape
        (6, (32, 32), torch.Size([6, 3, 32, 32]))
        >>> positions, directions = views.eyes()
        >>> smaller = views.normalized(center=torch.zeros(3), scale=2.0)  # the sphere has radius 0.5 now
        >>> shape = nr.icosphere(2, radius=0.5)
        >>> smaller.draw(shape).alpha.shape
        torch.Size([6, 32, 32])
        >>> smaller.fragments(shape).face_index.shape
        torch.Size([6, 64, 64])
        >>> smaller.quality(shape)["iou"].min() > 0.99
        tensor(True)
        >>> views = views.to("cuda" if torch.cuda.is_available() else "cpu")
    """

    camera: Camera
    masks: Tensor
    photos: Tensor | None = None
    region: tuple[Tensor, float] | None = None
    normals: Tensor | None = None
    depth: Tensor | None = None
    gains: Tensor | None = None
    scenes: Tensor | None = None
    backgrounds: Tensor | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.camera, Camera):
            raise TypeError(f"camera: expected a Camera, got {type(self.camera).__name__}")
        if not len(self.camera):
            raise ValueError("camera: expected at least one view, got none")
        validate.floating("masks", self.masks, (len(self.camera), "H", "W"))
        for name in ("photos", "normals", "scenes", "backgrounds"):
            if getattr(self, name) is not None:
                validate.floating(name, getattr(self, name), (len(self.camera), 3, *self.size))
        if self.backgrounds is not None and (self.scenes is None or self.photos is None):
            raise ValueError("backgrounds: expected photos and scenes besides, got none")
        if self.depth is not None:
            validate.floating("depth", self.depth, (len(self.camera), *self.size))
        if self.gains is not None:
            validate.floating("gains", self.gains, (len(self.camera), 3))
        empty = torch.nonzero(self.masks.amax((1, 2)) <= 0.5).flatten().tolist()
        if empty:
            raise ValueError(f"masks: expected an object in every view, got an empty mask in view {empty[0]}")

    def __len__(self) -> int:
        return len(self.camera)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the images in pixels."""
        return self.masks.shape[1], self.masks.shape[2]

    @classmethod
    def of(
        cls,
        mesh: Mesh | UVMesh,
        camera: Camera,
        size: int | tuple[int, int] = SIZE,
        *,
        normals: bool = False,
        depth: bool = False,
        **options: Any,
    ) -> Views:
        """Render a known mesh from N cameras.

        Args:
            mesh: The mesh.
            camera: N cameras.
            size: Side of the images, or height and width, in pixels.
            normals: Whether to add normals: of faces, or smooth ones if ``shading`` is not "flat".
            depth: Whether to add depth.
            **options: Options of `render`. The light is None unless given.

        Returns:
            The views, with photos, detached.

        Raises:
            TypeError, ValueError: As `render`, or the mesh is invisible in a view.
        """
        with torch.no_grad():
            images = render(mesh, camera, size, outputs=("rgb", "alpha"), **{"light": None, **options})
            views = cls(camera, images.alpha, images.rgb)
            if not normals and not depth:
                return views
            geometry: dict[str, Any] = {name: options[name] for name in ("near", "far", "shading") if name in options}
            plain = {"anti_aliasing": False, "light": None, **geometry}
            maps = render(mesh, camera, size, outputs=("normal", "depth", "alpha"), **plain)
        known = maps.depth * maps.alpha
        return replace(views, normals=maps.normal if normals else None, depth=known if depth else None)

    def __getitem__(self, index: Sequence[int] | slice) -> Views:
        """Select views by a slice or a list of numbers. Views of a slice share memory with the originals."""
        is_slice = isinstance(index, slice) and (index.step is None or index.step > 0)
        rows: Any = index if is_slice else torch.arange(len(self))[index].to(self.masks.device)
        photos, *maps = (None if part is None else part[rows] for part in self._optional())
        return Views(self.camera[rows], self.masks[rows], photos, self.region, *maps)

    def _optional(self) -> tuple[Tensor | None, ...]:
        """Return photos and what follows the region."""
        return self.photos, self.normals, self.depth, self.gains, self.scenes, self.backgrounds

    def silhouettes(self) -> Views:
        """Leave out colours.

        Returns:
            Views without photos, scenes and backgrounds.

        Example:
            >>> Views.of(mesh, camera, 32).silhouettes().photos is None
            True
        """
        return replace(self, photos=None, scenes=None, backgrounds=None)

    def to(self, device: torch.device | str) -> Views:
        """Copy the views to another device.

        Args:
            device: Device of the copy.

        Returns:
            The copy.
        """
        photos, *maps = (None if part is None else part.to(device) for part in self._optional())
        region = self.region and (self.region[0].to(device), self.region[1])
        return Views(self.camera.to(device), self.masks.to(device), photos, region, *maps)

    def normalized(self, center: Tensor, scale: float) -> Views:
        """Change the world of the cameras: ``center`` becomes the origin and ``scale`` the unit of length.

        Images stay the same.

        Args:
            center: [3], the new origin in the world of these cameras.
            scale: Length of the new unit, in units of this world, > 0.

        Returns:
            The same views, with other cameras.
        """
        camera = self.camera
        place = world_origin(camera) + torch.einsum("bij,j->bi", camera.rotation, center.to(camera.rotation))
        moved = with_extrinsics(camera if camera.perspective else camera.zoomed(scale), camera.rotation, place / scale)
        region = self.region and ((self.region[0] - center) / scale, self.region[1] / scale)
        depth = None if self.depth is None else self.depth / scale
        return replace(self, camera=moved, region=region, depth=depth)

    def eyes(self) -> tuple[Tensor, Tensor]:
        """Compute the cameras' positions and viewing directions in world space.

        Returns:
            Positions [N, 3] and unit viewing directions [N, 3].
        """
        return self.camera.position, self.camera.forward

    def draw(self, shape: tuple[Tensor, ...], outputs: str | Sequence[str] = "alpha", gradient: str = "edge") -> Images:
        """Render a mesh from all cameras without light, because fitted colours include the light of the photos.

        Colours are multiplied by ``gains``, if there are any.

        Args:
            shape: (vertices, faces) or (vertices, faces, textures).
            outputs: As in `render`.
            gradient: Gradient estimator, "edge" or "nmr".

        Returns:
            Images of the size of the masks, N each.

        Raises:
            TypeError, ValueError: As `render`.
        """
        options: dict[str, Any] = {"gradient": gradient, **self._limits()}
        images = render(shape, self.camera, self.size, light=None, outputs=outputs, **options)
        if self.gains is None or not hasattr(images, "rgb"):
            return images
        return images.replace(rgb=images.rgb * self.gains[:, :, None, None])

    def fragments(self, shape: tuple[Tensor, ...], anti_aliasing: bool = True) -> Fragments:
        """Rasterise a mesh from all cameras.

        Args:
            shape: (vertices, faces).
            anti_aliasing: As in `render`.

        Returns:
            Fragments of the size of the masks, or of twice that size under anti-aliasing, N each.

        Raises:
            TypeError, ValueError: As `fragments`.
        """
        return fragments(shape, self.camera, self.size, anti_aliasing=anti_aliasing, **self._limits())

    def _limits(self) -> dict[str, Any]:
        """Choose near and far planes: the far one is behind objects of size 1, however far away the cameras are."""
        return {"near": _NEAR, "far": 4 * (float(self.eyes()[0].detach().norm(dim=1).max()) + 1)}

    def cut_out(self, alpha: Tensor) -> Tensor:
        """Remove the known background from the photos by alpha compositing: photo = object + (1 - alpha) · background.

        Args:
            alpha: [N, H, W] in [0, 1], coverage of the pixels by the object.

        Returns:
            [N, 3, H, W], the object on black; 0 where neither the coverage nor the mask shows it. Where the background
            is not known, and without backgrounds, these are the photos, which the masks cut out.

        Raises:
            ValueError: There are no photos.

        Example:
            >>> views = Views.of(mesh, camera, 32)
            >>> views = replace(views, scenes=views.photos, backgrounds=torch.zeros_like(views.photos))
            >>> torch.equal(views.cut_out(views.masks), views.photos)
            True
        """
        photos = photos_of(self)
        if self.scenes is None or self.backgrounds is None:
            return photos
        found = self.scenes - (1 - alpha[:, None]) * self.backgrounds
        inside = torch.maximum(alpha, self.masks)[:, None] > 0
        return torch.where(self.backgrounds.isnan(), photos, torch.where(inside, found, 0.0))

    def quality(self, shape: tuple[Tensor, ...]) -> dict[str, Tensor]:
        """Compare a mesh with the views.

        Args:
            shape: (vertices, faces) or (vertices, faces, textures).

        Returns:
            "iou" [N], IoU of silhouettes; and "psnr" [N] in decibels if both have colours. The PSNR is that of the
            whole image on black, as for NeRF's data sets; with backgrounds, `cut_out` makes the photos for it.

        Raises:
            TypeError, ValueError: As `render`.
        """
        colored = self.photos is not None and len(shape) == 3
        found: dict[str, list[Tensor]] = {"iou": [], "psnr": []} if colored else {"iou": []}
        with torch.no_grad():
            for start in range(0, len(self), VIEWS_PER_PASS):
                part = self[start : start + VIEWS_PER_PASS]
                images = part.draw(shape, ("rgb", "alpha") if colored else "alpha")
                found["iou"].append(mask_iou(images.alpha, part.masks))
                if colored:
                    error = (images.rgb.clamp(0, 1) - part.cut_out(images.alpha)).square().mean((1, 2, 3))
                    found["psnr"].append(-10 * error.clamp(min=1e-10).log10())
        return {name: torch.cat(values) for name, values in found.items()}


def photos_of(views: Views) -> Tensor:
    """Return the photos of views; raise ValueError if there are none."""
    if views.photos is None:
        raise ValueError("views: expected photos, got silhouettes only")
    return views.photos


def mask_iou(alpha: Tensor, masks: Tensor) -> Tensor:
    """Compute the IoU [B] of rendered silhouettes and masks [B, H, W], which may have been rounded to eight bits."""
    return metrics.silhouette_iou(alpha.detach(), masks, threshold=_INSIDE)


def views_of_step(count: int, batch: int, seed: int, step: int) -> list[int]:
    """Choose up to ``batch`` of ``count`` views for a step of descent: all in turn, reshuffled after each round."""
    rows: list[int] = []
    for place in range(step * batch, (step + 1) * batch):
        rows.append(int(torch.randperm(count, generator=generator(seed, place // count))[place % count]))
    return sorted(set(rows))


def downscale(image: Tensor, size: int) -> Tensor:
    """Shrink an image [C, H, W] by area averaging until its longer side has at most ``size`` pixels."""
    height, width = image.shape[1:]
    if max(height, width) <= size:
        return image
    scale = size / max(height, width)
    return F.interpolate(image[None], (max(round(height * scale), 1), max(round(width * scale), 1)), mode="area")[0]


def mask_values(views: Views, masks: Tensor, points: Tensor) -> Iterator[Tensor]:
    """Look up points [P, 3] of the world in masks [N, H, W] of the images of all views, one view after the other.

    Yields interpolated values [P]; outside of the image that at its border, as the object may continue there; behind
    the camera 0.
    """
    aspect = views.size[1] / views.size[0]
    for index in range(len(views)):
        screen = views[index : index + 1].camera(points, aspect=aspect)[0]
        place = torch.stack((screen[:, 0], -screen[:, 1]), -1)[None, None]
        value = F.grid_sample(masks[index][None, None], place, padding_mode="border", align_corners=False)[0, 0, 0]
        yield torch.where(screen[:, 2] > 0, value, 0.0)


def view_center(views: Views) -> tuple[Tensor, float]:
    """Find where the cameras look: the point [3] nearest to all optical axes, and how far around it to search."""
    eye, forward = views.eyes()
    # The ridge picks the point nearest to the origin if axes are parallel.
    across = torch.eye(3).to(eye) - forward[:, :, None] * forward[:, None, :]
    matrix = across.sum(0) + 1e-4 * len(views) * torch.eye(3).to(eye)
    center = torch.linalg.solve(matrix, torch.einsum("bij,bj->i", across, eye))
    near = float((eye - center).norm(dim=1).min())
    return center, max(_REACH * near if views.camera.perspective else _orthographic_half_width(views), 1e-6)


def _orthographic_half_width(views: Views) -> float:
    """Return half the width of the widest orthographic view, in world units."""
    return float(1 / torch.as_tensor(views.camera.scale).min())
