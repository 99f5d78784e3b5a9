"""`neural-renderer pose`: position and rotation of a known object in pictures."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
import torch.nn.functional as F
from torch import Tensor

from ...camera import Camera
from ...camera.files.opencv import camera_rows, save_cameras
from ...io import save_image
from ...io.atomic_write import write_file
from ...io.images import size_of
from ...meshes.uv_mesh import UVMesh
from ...version import __version__
from ..common.checks import REPORT, check_outputs, picture_files
from ..common.command import INTERRUPTED, MISMATCH, interruption, say, say_finished
from ..common.masks.rule import MaskRule
from ..common.observer import goes_on
from ..common.options import MaskOptions
from ..common.views.load import load_photo
from ..common.views.maps import read_depth
from ..common.views.views import WHOLE
from ..view.watching import stay, watching
from .find import ObjectPose, find_pose
from .options import PoseOptions
from .pictures import overlay, save_overlays
from .rig_command import run_rig

if TYPE_CHECKING:
    from ..view.viewer import Viewer

_OVERLAY, _PREVIEW, _CAMERAS = "overlay.png", "preview.png", "cameras.json"


@dataclass(frozen=True, eq=False)
class _Frame:
    """Pictures of one pose; ``size`` is their height and width in pixels as files."""

    files: list[Path]
    size: tuple[int, int]
    mask: Tensor
    photo: Tensor | None
    depth: Tensor | None


def run(options: PoseOptions) -> int:
    """Find the poses and write the results; return the exit code: 0, 3 without a match, 130 after Ctrl-C."""
    files = picture_files(options.images)
    camera = None if options.camera is None else Camera.load(options.camera)
    if options.rig and camera is not None:
        return run_rig(options, files, camera, lambda group: _load(options, group).mask)
    if camera is not None and len(camera) != len(files):
        raise ValueError(f"--camera: expected {len(files)} cameras, one for each picture, got {len(camera)}")
    results = [options.output / name for name in (_OVERLAY, _PREVIEW, _CAMERAS, REPORT)]
    check_outputs(results, [options.mesh, options.camera, *files])
    mesh = UVMesh.load(options.mesh, allow_outside=options.allow_outside)
    start = time.monotonic()
    groups = [files] if camera is not None else [[file] for file in files]
    with watching(options.watch) as viewer, interruption() as interrupted:
        found, lost = _track(options, mesh, groups, camera, viewer, interrupted)
        finished = len(found) + len(lost) == len(groups)
        if found:
            _write(options, mesh, found, time.monotonic() - start)
        say_finished(time.monotonic() - start, options.output, None)
        stay(viewer, finished and not interrupted)
    if not finished:
        return INTERRUPTED
    return MISMATCH if lost or any(pose.verdict == "mismatch" for _, pose in found) else 0


def mask_rule(mask: MaskOptions) -> MaskRule:
    """Make the rule that the options describe."""
    return MaskRule(*(getattr(mask, part.name) for part in fields(mask)))


def _load(options: PoseOptions, files: list[Path]) -> _Frame:
    """Load the pictures of one pose."""
    rule = mask_rule(options.mask)
    masks, photos, depths = [], [], []
    for file in files:
        mask, photo = load_photo(file, size=options.size, photos=options.photos, rule=rule, masks=options.masks)
        masks.append(mask)
        if photo is not None:  # which is multiplied by the mask
            photos.append((photo / mask.clamp(min=1e-3)).clamp(0, 1))
        if options.depth is not None:
            depths.append(_depth(options.depth, file, mask, options.depth_scale))
    if len({mask.shape for mask in masks}) > 1:
        raise ValueError(f"{files[0]}: expected pictures of one size with --camera, got several")
    colors = torch.stack(photos) if photos else None
    return _Frame(files, size_of(files[0]), torch.stack(masks), colors, torch.stack(depths) if depths else None)


def _depth(folder: Path, image: Path, mask: Tensor, scale: float) -> Tensor:
    """Read the depth of a picture, and reduce it to the size of its mask."""
    for suffix in (".png", ".npy"):
        file = folder / (image.stem + suffix)
        if file.is_file():
            depth = read_depth(file, size_of(image), scale)[None, None]
            known = F.interpolate((depth > 0).float(), tuple(mask.shape), mode="area")[0, 0]
            mean = F.interpolate(depth, tuple(mask.shape), mode="area")[0, 0]
            return torch.where(known > WHOLE, mean, 0.0)
    raise FileNotFoundError(f"{folder}: expected depth {image.stem}.png or {image.stem}.npy, got none")


def _track(
    options: PoseOptions,
    mesh: UVMesh,
    groups: list[list[Path]],
    camera: Camera | None,
    viewer: Viewer | None,
    interrupted: list[int],
) -> tuple[list[tuple[_Frame, ObjectPose]], list[Path]]:
    """Find the pose of each group of pictures, starting from the previous one; list pictures without a pose, too."""
    found: list[tuple[_Frame, ObjectPose]] = []
    lost: list[Path] = []
    for number, files in enumerate(groups, 1):
        if interrupted or not goes_on(viewer, interrupted):
            break
        last = found[-1][1] if found and found[-1][1].verdict != "mismatch" else None
        angle = options.viewing_angle
        if angle is None and camera is None:
            angle = next((pose.viewing_angle for _, pose in found if pose.verdict != "mismatch"), None)
        try:
            frame = _load(options, files)
            pose = find_pose(
                mesh,
                frame.photo,
                frame.mask,
                frame.depth,
                viewing_angle=angle,
                camera=camera,
                fit_focal=options.fit_focal,
                hidden=options.hidden,
                start=last,
            )
        except ValueError as error:
            if len(groups) == 1 or (number == len(groups) and not found):
                raise
            lost += files
            say(f"{files[0].name} is left out: {error}", "red")
            continue
        found.append((frame, pose))
        say(f"{files[0].name}: {pose.verdict}, agreement {pose.agreement:.3f}{_other(pose)}")
        for sentence in pose.advice:
            say(sentence, "red" if pose.verdict == "mismatch" else "yellow")
        save_image(options.output / _PREVIEW, overlay(mesh, pose.camera, frame.photo, frame.mask))
        if viewer is not None:
            photos = None if frame.photo is None else frame.photo * frame.mask[:, None]
            viewer.show_cameras(pose.camera, photos, frame.mask)
            numbers = {"agreement": pose.agreement, "residual": pose.residual}
            viewer.observe("pose", number, len(groups), numbers, lambda: mesh)
    return found, lost


def _other(pose: ObjectPose) -> str:
    """Compare the residual with that of the runner-up."""
    if not len(pose.others):
        return f", residual {pose.residual:.3f}"
    return f", residual {pose.residual:.3f}, runner-up {float(pose.other_residuals[0]):.3f}"


def _write(options: PoseOptions, mesh: UVMesh, found: list[tuple[_Frame, ObjectPose]], seconds: float) -> None:
    """Write the overlay, the cameras and the report."""
    save_overlays(options.output / _OVERLAY, [(mesh, pose.camera, frame.photo, frame.mask) for frame, pose in found])
    names = [file.name for frame, _ in found for file in frame.files]
    cameras = [pose.camera.with_K(frame.size) for frame, pose in found]
    save_cameras(options.output / _CAMERAS, cameras, names)
    first = found[0][1].camera
    report: dict[str, Any] = {
        "version": __version__,
        "inputs": {
            "images": str(found[0][0].files[0].resolve()),
            "mesh": str(options.mesh.resolve()),
            "photos": options.photos,
            "background": options.mask.background,
        },
        "seconds": round(seconds, 2),
        "camera": {
            "eye": first.position[0].tolist(),
            "direction": first.forward[0].tolist(),
            "up": first.up[0].tolist(),
            "viewing_angle": found[0][1].viewing_angle,
        },
        "cameras": [row for camera in cameras for row in camera_rows(camera)],
        "poses": [{"images": [str(f.resolve()) for f in frame.files], **_row(pose)} for frame, pose in found],
    }
    write_file(options.output / REPORT, json.dumps(report, indent=1) + "\n")


def _row(pose: ObjectPose) -> dict[str, Any]:
    """List the figures of a pose."""
    spread = pose.covariance.diagonal().sqrt()
    return {
        "verdict": pose.verdict,
        "advice": list(pose.advice),
        "agreement": round(pose.agreement, 4),
        "residual": round(pose.residual, 4),
        "matrix": pose.matrix.tolist(),
        "viewing_angle": pose.viewing_angle,
        "deviation": {
            "turn_degrees": torch.rad2deg(spread[:3]).tolist(),
            "place": spread[3:6].tolist(),
            **({"focal_length": float(spread[6])} if len(spread) == 7 else {}),
        },
        "covariance": pose.covariance.tolist(),
        "others": [
            {"matrix": matrix.tolist(), "residual": round(float(residual), 4)}
            for matrix, residual in zip(pose.others, pose.other_residuals, strict=True)
        ],
    }
