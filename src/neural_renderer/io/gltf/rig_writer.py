"""Nodes, skin and animations of a GLB file."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .rig_reader import RigFile, Track

Accessor = Callable[..., int]
"""Appends an array [n, width] to the file; returns the number of its accessor."""


def rig_entries(rig: RigFile, accessor: Accessor) -> dict[str, Any]:
    """Return scenes, nodes, the skin and animations. Each joint has a node; the last node is that of mesh 0.

    A skin may name a joint only once, so a joint with several bones has a child node for each further bone.
    """
    nodes: list[dict[str, Any]] = []
    for number, name in enumerate(rig.names):
        node: dict[str, Any] = {"name": name}
        frame = (rig.translations, rig.rotations, rig.scales)
        for key, values, plain in zip(("translation", "rotation", "scale"), frame, (0, (0, 0, 0, 1), 1), strict=True):
            if (values[number] != plain).any():
                node[key] = values[number].tolist()
        nodes.append(node)
    for number, parent in enumerate(rig.parents):
        if parent >= 0:
            nodes[parent].setdefault("children", []).append(number)
    joints: list[int] = []
    for joint in rig.bones.tolist():
        if joint in joints:
            nodes[joint].setdefault("children", []).append(len(nodes))
            nodes.append({"name": f"{rig.names[joint]} again"})
            joint = len(nodes) - 1
        joints.append(joint)
    matrices = rig.inverse_bind.transpose(0, 2, 1).reshape(-1, 16).astype("<f4")
    roots = [number for number, parent in enumerate(rig.parents) if parent < 0]
    entries: dict[str, Any] = {
        "scenes": [{"nodes": [*roots, len(nodes)]}],
        "nodes": [*nodes, {"mesh": 0, "skin": 0}],
        "skins": [{"joints": joints, "inverseBindMatrices": accessor(matrices)}],
    }
    animations = [_animation(rig, name, tracks, len(nodes), accessor) for name, tracks in rig.animations if tracks]
    return entries | ({"animations": animations} if animations else {})


def _animation(rig: RigFile, name: str, tracks: list[Track], mesh: int, accessor: Accessor) -> dict[str, Any]:
    """Describe an animation; ``mesh`` is the number of the mesh's node."""
    shaping = [track for track in tracks if track.path == "weights"]
    if len(shaping) > 1:
        raise ValueError(f"animations: expected one track of weights in {name!r}, got {len(shaping)}")
    channels: list[Any] = []
    samplers: list[Any] = []
    for track in tracks:
        values = track.values
        if track.path == "weights":  # of all targets, since the file has one mesh
            width, before = len(rig.targets), track.joint
            values = np.zeros((*values.shape[:-1], width))
            key = values[:, 1] if values.ndim == 3 else values
            key[:] = rig.target_weights
            values[..., before : before + track.values.shape[-1]] = track.values
        flat = values.reshape(-1, 1) if track.path == "weights" else values.reshape(-1, values.shape[-1])
        times = accessor(track.times.reshape(-1, 1).astype("<f4"), bounds=True)
        node = mesh if track.path == "weights" else track.joint
        channels.append({"sampler": len(samplers), "target": {"node": node, "path": track.path}})
        output = accessor(flat.astype("<f4"))
        samplers.append({"input": times, "output": output, "interpolation": track.interpolation})
    return {"name": name, "channels": channels, "samplers": samplers}
