"""`neural-renderer pose --rig`: the rotations of a rig's joints, from known cameras."""

from __future__ import annotations

import json
import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...camera import Camera
from ...camera.rotations import from_axis_angle, to_quaternion
from ...io.atomic_write import write_file
from ...io.gltf.rig_reader import Track
from ...io.images import size_of
from ...meshes.rigs import Rig
from ...rendering.forward import render
from ...version import __version__
from ..common.checks import REPORT, check_outputs
from ..common.command import INTERRUPTED, MISMATCH, interruption, say, say_finished
from .find import MISMATCH_ADVICE
from .options import PoseOptions
from .pictures import save_overlays
from .rig_fit import RigFit, fit_rig, load_keypoints

_RESULT, _OVERLAY = "rig.glb", "overlay.png"
_AGREES = 0.9  # intersection over union of silhouettes


def run_rig(options: PoseOptions, files: list[Path], camera: Camera, masks: Any) -> int:
    """Fit each moment, starting from the previous one. Exit codes: 0, 3 if silhouettes do not match, 130 after Ctrl-C.

    ``masks`` loads those of pictures, [N, H, W].
    """
    views = len(camera)
    if len(files) % views:
        raise ValueError(f"--camera: expected pictures of each moment by {views} cameras, got {len(files)} pictures")
    points = None if options.keypoints is None else load_keypoints(options.keypoints)
    if points is not None and len(points) != len(files):
        raise ValueError(f"--keypoints: expected those of {len(files)} pictures, got {len(points)}")
    check_outputs(
        [options.output / name for name in (_RESULT, _OVERLAY, REPORT)], [options.mesh, options.camera, *files]
    )
    rig = Rig.load(options.mesh, allow_outside=options.allow_outside)
    shape = rig.target_weights if options.shape else None
    begin = time.monotonic()
    found: list[RigFit] = []
    drawings, report = [], []
    failure: ValueError | None = None
    with interruption() as interrupted:
        for first in range(0, len(files), views):
            if interrupted:
                break
            group = files[first : first + views]
            before, limits = found[-1] if found else None, math.radians(options.limits)
            try:
                goal = masks(group)
                several = None if points is None else points[first : first + views]
                keypoints = several and [_scaled(one, file, goal) for one, file in zip(several, group, strict=True)]
                fit = fit_rig(rig, camera, goal, keypoints, limits=limits, shape=shape, start=before)
            except ValueError as error:  # results of earlier moments are kept
                named = any(file.name in str(error) for file in group)
                failure = error if named else ValueError(f"{group[0].name}: {error}")
                break
            found.append(fit)
            mesh = rig.posed(fit.pose)
            far = 2 * float(camera.project(mesh.vertices, tuple(goal.shape[1:]))[1].max())
            size = (goal.shape[1], goal.shape[2])
            shape_only = mesh.vertices, mesh.faces
            drawn = render(shape_only, camera, size, outputs=("alpha",), near=1e-3 * far, far=far).alpha
            agreement = float(torch.minimum(drawn, goal).sum() / torch.maximum(drawn, goal).sum())
            advice = [] if agreement >= _AGREES else [MISMATCH_ADVICE.format(_AGREES, agreement)]
            verdict = "mismatch" if advice else "match"
            say(f"{group[0].name}: {verdict}, agreement {agreement:.3f}")
            for sentence in advice:
                say(sentence, "red")
            drawings.append((mesh, camera, None, goal))
            report.append({"verdict": verdict, "advice": advice, **_row(rig, group, fit, agreement)})
    if not found:
        if failure:
            raise failure
        return INTERRUPTED
    save_overlays(options.output / _OVERLAY, drawings)
    _with_track(rig, found, options.fps).save(options.output / _RESULT)
    content = {"version": __version__, "mesh": str(options.mesh.resolve()), "poses": report}
    write_file(options.output / REPORT, json.dumps(content, indent=1) + "\n")
    say_finished(time.monotonic() - begin, options.output, None)
    if failure:
        raise failure
    if len(found) < len(files) // views:
        return INTERRUPTED
    return MISMATCH if any(row["advice"] for row in report) else 0


def _scaled(points: dict[str, list[float]], file: Path, masks: Tensor) -> dict[str, list[float]]:
    scale = masks.shape[2] / size_of(file)[1]
    return {name: [x * scale, y * scale, weight] for name, (x, y, weight) in points.items()}


def _row(rig: Rig, files: list[Path], fit: RigFit, agreement: float) -> dict[str, Any]:
    """List the figures of a moment; joints at rest are left out."""
    turned = {name: angles.tolist() for name, angles in zip(rig.names, fit.angles, strict=True) if angles.any()}
    return {
        "images": [str(file.resolve()) for file in files],
        "agreement": round(agreement, 4),
        "angles": turned,
        "weights": fit.pose.weights.tolist(),
        "translation": fit.translation.tolist(),
    }


def _with_track(rig: Rig, found: list[RigFit], fps: float) -> Rig:
    """Copy a rig, with the poses found as its animation."""
    times = np.arange(len(found)) / fps
    turned = torch.stack([rig.rotations @ from_axis_angle(fit.angles) for fit in found])
    quaternions = to_quaternion(turned)[..., [1, 2, 3, 0]].double().numpy()
    tracks = [Track(joint, "rotation", times, quaternions[:, joint]) for joint in range(len(rig.parents))]
    places = torch.stack([fit.pose.translations for fit in found]).double().numpy()
    roots = (joint for joint, parent in enumerate(rig.parents) if parent < 0)
    tracks += [Track(joint, "translation", times, places[:, joint]) for joint in roots]
    if len(rig.targets):
        tracks.append(Track(0, "weights", times, torch.stack([fit.pose.weights for fit in found]).double().numpy()))
    return rig.replace(animations={"found": tracks})
