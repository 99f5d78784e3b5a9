"""Posed images from files, and the region of the object; see `camera.files` for the formats of cameras."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

from ....base import validate
from ....camera import Camera
from ....camera.files import CameraFile, PosedImage, find_camera_file, read_camera_file
from ....io.files import existing, reason, short
from ....io.images import load_reduced
from ....io.named_files import is_file, is_outside, outside_error
from ....meshes.primitives import cube
from ..masks.rule import MaskRule, as_mask, mask_beside, transparency
from ..options import LEAST_SIDE, SIZE
from ..short_names import short_names
from .maps import MapFormat, load_maps
from .undistortion import undistort
from .views import Views, downscale, mask_values

_FINER = 3  # larger photographs are reduced on reading, to at least this multiple of the size that is fitted
MASK_FOLDERS = ("masks", "mask")
"""Folders beside images that may have their masks."""

_RULE = ("rule.background", "rule.tolerance")
_RULE_PLACES = {
    "mask_below": "rule.below",
    "mask_open": "rule.opening",
    "mask_close": "rule.closing",
    "mask_fill": "rule.fill",
}
_SUFFIXES = ("", ".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG")
Box = tuple[float, float, float, float, float, float]
_SHARE = 0.9  # share of the views in whose masks a point of the object must lie
_COLORED, _MOST_COLORED = 0.1, 0.005  # difference of channels, and share of such pixels that a silhouette may have
_LEAST_IMAGES = 2  # fewer images determine no shape
_LEAST_POINTS = 8  # fewer points determine no region
_TAIL = 0.02  # share of the points on each side that are left out as errors
_LARGER = 1.5  # size of the region relative to the box around the points, which smooth parts lack


@short_names(*_RULE, "map_format.normals_in", "map_format.depth_scale", **_RULE_PLACES)
def load_views(
    path: str | os.PathLike[str] | CameraFile,
    *,
    size: int = SIZE,
    photos: bool = True,
    rule: MaskRule = MaskRule(),  # noqa: B008 (immutable)
    masks: str | os.PathLike[str] | None = None,
    box: Box | None = None,
    maps: bool = True,
    map_format: MapFormat = MapFormat(),  # noqa: B008 (immutable)
    allow_outside: bool = False,
    scenes: bool = False,
    bad: dict[str, str] | None = None,
) -> Views:
    """Load posed images from a folder.

    The mask of an image is, in this order: the mask file that the camera file names; a file of its name in the folder
    ``masks``; its alpha channel; what ``rule`` leaves; what differs from a plain background; the
    outline of ``box``. A box limits all masks to its outline.

    The folders ``normals`` and ``depth`` beside the images may have a map for each image, with its name, .png or .npy,
    as the command ``neural-renderer render --save`` writes them. A .png holds (n + 1) / 2 of normals, and 16 bits of
    depth; 0 is no depth. A .npy holds normals, or depth along the viewing axis in world units.

    Args:
        path: Camera file, or a folder that contains one: ``transforms.json`` (NeRF, Blender, nerfstudio,
            instant-ngp), ``cameras.json`` or ``cameras.csv``, a model of COLMAP, ``cameras.npz`` (IDR, NeuS),
            ``scene_camera.json`` (BOP), or ``*_par.txt`` (Middlebury). The modules in
            ``neural_renderer.camera.files`` describe the formats. Or what `read_camera_file` of that package returned.
        size: Longer side in pixels, ≥ 16; larger images are scaled down.
        photos: Whether to use colours. Without colours, an image without a mask is a mask itself, white on black.
        rule: How to separate the object from the background in images without mask and alpha channel. Keywords set
            single fields, too: ``background``, ``tolerance``, ``mask_below``, ``mask_open``, ``mask_close``,
            ``mask_fill``.
        masks: Folder of mask files, named like the images, with any suffix or one more; None searches the folders
            ``masks`` and ``mask`` beside the images.
        box: Corners (x, y, z, x, y, z) of a box around the object, in the world of the cameras.
        maps: Whether to read maps of normals and depth.
        map_format: Conventions of the maps; short: ``normals_in``, ``depth_scale``.
        allow_outside: Whether the camera file may name images outside of its folder.
        scenes: Whether to keep whole photographs, too.
        bad: Receives the reason for each image, by its name, that cannot be used; the others are loaded, if they are at
            least half of all, and two. None, the default, raises the first one.

    Returns:
        The views, on the CPU. The sparse points of COLMAP, or the box, give their ``region``.

    Raises:
        FileNotFoundError: The folder, the camera file or an image does not exist.
        TypeError, ValueError: An argument is out of range, a file is malformed, a key is missing, image sizes differ,
            an image is larger than `load_image` accepts or outside of the folder without ``allow_outside``, a mask is
            empty, or nothing separates the object from the background. The error of an image that ``bad`` could
            receive has the image's name as its attribute ``image``.

    Example:
        >>> disc = nr.render(nr.Mesh.icosphere(2), nr.Camera.look_at((0.0, 0.0, -2.7)), 64).alpha[0]
        >>> nr.save_image("photos/000.png", disc)
        >>> table = "file,azimuth,elevation,distance\\n000.png,0,0,2.7\\n"
        >>> _ = Path("photos/cameras.csv").write_text(table)
        >>> views = load_views("photos", size=32, photos=False)
        >>> len(views), views.size
        (1, (32, 32))
    """
    size = validate.whole("size", size, LEAST_SIDE)
    source = path if isinstance(path, CameraFile) else read_camera_file(find_camera_file(Path(path)))
    folder = None if masks is None else Path(masks)
    if folder is not None and not folder.is_dir():
        raise FileNotFoundError(f"masks: expected a folder of masks, got {folder}, which is none")
    found: list[Tensor] = []
    named: list[tuple[PosedImage, Path]] = []
    full = (0, 0)
    for entry in source.images:
        try:
            file, mask_file = find_files(source, entry, folder, allow_outside)
            image, shape_of_file = _load_as_calibrated(file, entry, _FINER * size)
            shape = full if found else shape_of_file
            _check_size(file, shape_of_file, shape)
            mask = _mask(file, mask_file, image, shape_of_file, photos, rule, box is not None)
            planes = _premultiplied(file, mask_file, image, mask)
        except (OSError, ValueError) as error:
            if bad is None:
                error.image = entry.name  # type: ignore[union-attr]
                raise
            bad[entry.name] = reason(error)
            continue
        full = shape
        if scenes:
            planes = torch.cat((planes, image[..., :3].permute(2, 0, 1)))
        if entry.lens.needs_undistortion:
            planes = undistort(planes, entry.lens.model, entry.lens.values, entry.lens.intrinsics(full))
        found.append(downscale(planes, size))
        named.append((entry, file))
    if bad:
        source = replace(source, images=_enough(source, bad))
    camera, alphas = source.cameras(full), torch.stack([planes[3] for planes in found])
    colors = torch.stack([planes[:3] for planes in found]) if photos else None
    views = Views(camera, alphas, colors, scenes=torch.stack([planes[4:] for planes in found]) if scenes else None)
    if box is not None:
        outlines, region = outline_of_box(camera, box, views.size)
        colors = None if colors is None else colors * outlines[:, None]
        views = replace(views, masks=alphas * outlines, photos=colors, region=region)
    elif source.points is not None:
        views = replace(views, region=region_of_points(views, source.points))
    if not maps:
        return views
    return load_maps(views, named, source.folders, full, map_format)


def find_files(
    source: CameraFile, entry: PosedImage, masks: Path | None = None, allow_outside: bool = False
) -> tuple[Path, Path | None]:
    """Find the image, and the mask or None, of an entry of a camera file; raise what `load_views` raises.

    ``masks`` is the folder of masks; None searches the usual folders beside the images.
    """
    image = find_image(source, entry.name, allow_outside)
    if entry.mask is not None:
        return image, find_image(source, entry.mask, allow_outside)
    usual = [root / name for root in (image.parent, *source.folders) for name in MASK_FOLDERS]
    folders = usual if masks is None else [masks]
    mask = next(filter(None, (mask_beside(folder, entry.name) for folder in folders)), None)
    if mask is None and masks is not None:
        raise FileNotFoundError(f"{masks}: expected a mask {Path(entry.name).stem}.png, got none")
    return image, mask


def _enough(source: CameraFile, bad: Mapping[str, str]) -> tuple[PosedImage, ...]:
    """Return the images that are not bad. Raises ValueError, with the first reason, if they are too few."""
    images = tuple(entry for entry in source.images if entry.name not in bad)
    least = max(_LEAST_IMAGES, math.ceil(len(source.images) / 2))
    if len(images) < least:
        raise ValueError(
            f"{source.path}: expected at least {least} of {len(source.images)} images that can be used, got "
            f"{len(images)}; {next(iter(bad.values()))}"
        )
    return images


@short_names(*_RULE, **_RULE_PLACES)
def load_photo(
    path: str | os.PathLike[str],
    *,
    size: int = SIZE,
    photos: bool = True,
    rule: MaskRule = MaskRule(),  # noqa: B008 (immutable)
    masks: str | os.PathLike[str] | None = None,
) -> tuple[Tensor, Tensor | None]:
    """Load one image without a camera.

    Args:
        path: Image file.
        size: Longer side in pixels, ≥ 16; larger images are scaled down.
        photos: Whether to use colours; see `load_views`.
        rule, masks: As in `load_views`.

    Returns:
        The mask [H, W], and RGB multiplied by the mask [3, H, W], or None without ``photos``.

    Raises:
        OSError, TypeError, ValueError: As `load_views`.

    Example:
        >>> nr.save_image("disc.png", nr.render(nr.Mesh.icosphere(2), camera, 64).alpha[0])
        >>> mask, photo = load_photo("disc.png", size=32, photos=False)
        >>> mask.shape
        torch.Size([32, 32])
    """
    size = validate.whole("size", size, LEAST_SIDE)
    image, full = load_reduced(existing(path), least=_FINER * size)
    file = None if masks is None else mask_beside(Path(masks), Path(path).name)
    if file is None and masks is not None:
        raise FileNotFoundError(f"{masks}: expected a mask {Path(path).stem}.png, got none")
    mask = _mask(Path(path), file, image, full, photos, rule)
    small = downscale(_premultiplied(Path(path), file, image, mask), size)
    return small[3], small[:3] if photos else None


def _load_as_calibrated(file: Path, entry: PosedImage, least: int) -> tuple[Tensor, tuple[int, int]]:
    """Load an image as its pixels are stored, or rotated by its EXIF data if only this fits the calibrated size.

    ``least`` is that of `load_reduced`: the least longer side to reduce it to.
    """
    image, full = load_reduced(file, least=least)
    if entry.lens.size is None or _has_aspect(full, entry.lens.size):
        return image, full
    upright = load_reduced(file, upright=True, least=least)
    return upright if _has_aspect(upright[1], entry.lens.size) else (image, full)


def _has_aspect(full: tuple[int, int], size: tuple[float, float]) -> bool:
    """Return whether an image of a height and width has the aspect of a size (height, width), to a pixel."""
    height, width = full
    return abs(width * size[0] - height * size[1]) <= max(size[0], size[1], height, width)


def _premultiplied(file: Path, mask_file: Path | None, image: Tensor, mask: Tensor) -> Tensor:
    """Multiply colours by the mask: [4, H, W]. Raises ValueError if the mask is empty."""
    if float(mask.max()) <= 0.5:
        raise ValueError(f"{mask_file or file}: expected an object in the mask, got an empty one")
    result = image.new_empty(4, *mask.shape)  # planes, which `downscale` reads five times as fast
    torch.mul(image[..., :3].permute(2, 0, 1), mask, out=result[:3])
    result[3] = mask
    return result


def _check_size(path: Path, size: tuple[int, int], full: tuple[int, int]) -> None:
    """Raise ValueError if a height and width are not those of the other images."""
    if size != full:
        raise ValueError(f"{path}: expected {full[1]} x {full[0]} pixels like the others, got {size[1]} x {size[0]}")


def _mask(
    file: Path,
    mask_file: Path | None,
    image: Tensor,
    full: tuple[int, int],
    photos: bool,
    rule: MaskRule,
    has_box: bool | None = None,
) -> Tensor:
    """Find the mask [H, W] in [0, 1] of an image, which may be smaller than its full size; see `load_views`.

    ``has_box`` is None for callers without the option of a box.
    """
    height = image.shape[0]
    if mask_file is not None:
        picture, size = load_reduced(mask_file, least=max(image.shape[:2]))
        _check_size(mask_file, size, full)
        mask = as_mask(picture)
        return mask if mask.shape[0] == height else F.avg_pool2d(mask[None], full[0] // height)[0]
    alpha = transparency(image)
    if alpha is not None:
        return alpha
    if not photos and rule.background is None and rule.below is None:
        return _silhouette(file, image[..., :3])
    try:
        return rule.reduced(full[0] // height).find(image)
    except ValueError:
        if has_box:
            return torch.ones(image.shape[:2])
        others = " or background=R G B" if has_box is None else ", background=R G B or box=CORNERS"
        raise ValueError(
            f"{file}: expected an alpha channel, a mask or a plain background to separate the object, got none; give "
            f"masks=FOLDER, mask_below=VALUE{others}"
        ) from None


def _silhouette(file: Path, rgb: Tensor) -> Tensor:
    """Return the brightness of a silhouette [H, W, 3]; raise ValueError for photographs, and for black on white."""
    colored = float((rgb.amax(2) - rgb.amin(2) > _COLORED).float().mean())
    mask = rgb.mean(2)
    border = torch.cat((mask[0], mask[-1], mask[:, 0], mask[:, -1])) > 0.5
    if colored > _MOST_COLORED or float(border.float().mean()) > 0.5:
        what = f"colours in {colored:.0%} of it" if colored > _MOST_COLORED else "a white border"
        raise ValueError(
            f"{file}: expected a silhouette, white on black, without photos, got {what}; use the colours "
            "(photos=True), give masks=FOLDER, or define the background by background=R G B or mask_below=VALUE"
        )
    return mask


def outline_of_box(
    camera: Camera, box: tuple[float, ...], size: tuple[int, int]
) -> tuple[Tensor, tuple[Tensor, float]]:
    """Draw the outlines [N, H, W] in [0, 1] of a box with the opposite corners (x, y, z, x, y, z) in the world.

    Returns also its centre [3], and half its longest side. ValueError: there are not six finite numbers, or a side is
    not above 0.
    """
    values = [validate.number("box", value) for value in box]
    if len(values) != 6:
        raise ValueError(f"box: expected six numbers x, y, z, x, y, z, got {len(values)}")
    corners = torch.tensor(values).view(2, 3)
    center, half = corners.mean(0), (corners[1] - corners[0]).abs() / 2
    if not bool((half > 0).all()):
        raise ValueError(f"box: expected opposite corners that differ in x, y and z, got {tuple(box)}")
    vertices, faces = cube()
    views = Views(camera, torch.ones(len(camera), *size)).normalized(center, float(half.max()))
    return views.draw((vertices * half / half.max(), faces)).alpha, (center, float(half.max()))


def region_of_points(views: Views, points: Tensor) -> tuple[Tensor, float] | None:
    """Find the region of the object from points [P, 3] of the whole scene.

    Points outside of the masks belong to the surroundings. Returns the centre [3] of the others and half the side of a
    cube around them, with a margin; None if there are too few.
    """
    points = points.to(views.masks)
    count = torch.stack([value > 0.5 for value in mask_values(views, views.masks, points)]).sum(0)
    found = points[count >= _SHARE * len(views)]
    if len(found) < _LEAST_POINTS:
        return None
    least, most = (found.quantile(share, dim=0) for share in (_TAIL, 1 - _TAIL))
    return (least + most) / 2, _LARGER * float((most - least).max()) / 2


def find_image(source: CameraFile, name: str, allow_outside: bool = False) -> Path:
    """Find an image of a camera file in its folders; data sets of NeRF omit suffixes.

    FileNotFoundError: There is none. ValueError: The name leads out of the folder, and ``allow_outside`` is False.
    """
    for folder in source.folders:
        for suffix in _SUFFIXES:
            if is_file(folder / (name + suffix)) and (allow_outside or not is_outside(folder / "file", name)):
                return folder / (name + suffix)
    if not allow_outside and is_outside(source.path, name):
        raise outside_error(source.path, name)
    raise FileNotFoundError(f"{source.path}: expected a file {short(name)}, got nothing there")
