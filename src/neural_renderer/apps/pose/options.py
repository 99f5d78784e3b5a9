"""Options of `neural-renderer pose`. This module does not import torch."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from ..common.checks import (
    check_between,
    check_cameras,
    check_counts,
    check_earlier,
    check_folder,
    check_input_folder,
    check_inputs,
    picture_files,
)
from ..common.options import DEPTH_SCALE, LEAST_SIDE, SIZE, Mask, MaskOptions, Output, Watch, WatchOptions


@dataclass(frozen=True, kw_only=True)
class PoseOptions:
    """Find the pose of a known object in pictures, from photos, masks or depth, without an initial guess.

    IMAGE is a picture or a folder of pictures, sorted by name. Each picture has its own pose; the search starts from
    the pose of the previous one, as in a video. With --camera, all pictures show one pose, from known cameras.

    The folder OUTPUT gets report.json with the poses, cameras.json with cameras in the world of the mesh, which
    `render --camera` reads, overlay.png with the outlines of the object drawn on the pictures, and preview.png.

    Example: neural-renderer pose spot.obj photo.png -o pose --viewing-angle 20

    Example: neural-renderer pose drill.glb frames -o track --masks masks --hidden

    With --rig, the rotations of the joints of a .glb or .gltf file are found, too, from known cameras. OUTPUT gets
    rig.glb, whose animation "found" is the result, in place of cameras.json and preview.png.

    Example: neural-renderer pose duck.obj views -o pose --camera views/cameras.json

    Example: neural-renderer pose fox.glb views -o pose --camera views/cameras.json --rig --limits 60
    """

    mesh: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MESH")]
    """Mesh file: .obj, .ply, .stl, .off, .glb or .gltf."""
    images: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="IMAGE", name="IMAGE")]
    """Pictures, or folders of pictures."""
    output: Output
    """Folder for the results; it is made if missing."""
    viewing_angle: float | None = None
    """Half of the vertical field of view in degrees (above 0, below 90). By default it is fitted to the first picture
    and kept."""
    fit_focal: bool = False
    """Fit the focal length of each picture. The initial value, --viewing-angle, may be off by a third."""
    camera: Path | None = None
    """Camera file, as for `render`: the pictures show one pose, in the order of the cameras."""
    rig: bool = False
    """Find the rotations of the joints. The pictures are those of all cameras at the first moment, then the next."""
    keypoints: Path | None = None
    """With --rig, JSON file with positions of joints: a list with an object for each picture, such as
    [{"hand_l": [10.5, 20, 1]}], with x and y in pixels and a weight."""
    limits: float = 90.0
    """With --rig, largest angle of a joint from rest, about each of its axes, in degrees (above 0, up to 180)."""
    shape: bool = False
    """With --rig, find the weights of morph targets, too."""
    fps: float = 20.0
    """With --rig, moments per second (above 0)."""
    photos: bool = True
    """Use the colours of the pictures. Without photos, pictures are silhouettes, white on black."""
    hidden: bool = False
    """The object may be partly occluded; masks then show the visible part only. If that part does not determine the
    pose, a match may be wrong."""
    masks: Path | None = None
    """Folder of masks, white on black, named like the pictures. Pictures without transparency or mask are cut out by
    the options for masks below, else from a plain background."""
    depth: Path | None = None
    """Folder of depth images, .png of 16 bits or .npy, named like the pictures."""
    depth_scale: float = DEPTH_SCALE
    """Steps of a 16-bit depth .png for one unit of the mesh (above 0); 0 in the .png is no depth."""
    mask: Mask = field(default_factory=MaskOptions)
    size: int = SIZE
    """Scale larger pictures down to this longer side in pixels (at least 16)."""
    allow_outside: bool = False
    """Allow the mesh file to name materials and images outside of its folder. For trusted files only."""
    force: bool = False
    """Replace the results of an earlier run in the output folder."""
    watch: Watch = field(default_factory=WatchOptions)

    def validate(self) -> None:
        """Raise an error for options that are out of range or do not fit, for missing files, and without viser."""
        check_counts(self, size=LEAST_SIDE)
        check_between("depth-scale", self.depth_scale, 0.0, math.inf)
        if self.viewing_angle is not None:
            check_between("viewing-angle", self.viewing_angle, 0.0, 90.0)
            if self.camera is not None:
                raise ValueError("--viewing-angle: expected none with --camera, got both")
        if self.rig:
            self._check_rig()
        elif self.keypoints is not None or self.shape:
            raise ValueError("--keypoints, --shape: expected --rig with them, got a mesh without joints")
        check_inputs(self.mesh, *(path for path in self.images if not path.is_dir()), self.keypoints)
        check_cameras(self.camera)
        check_input_folder(self.masks, "a folder of masks")
        check_input_folder(self.depth, "a folder of depth images")
        picture_files(self.images)
        self.watch.validate()
        check_earlier(self.output, False, self.force)
        check_folder("--output", self.output)

    def _check_rig(self) -> None:
        watch = self.watch
        unused = {"hidden": self.hidden, "fit-focal": self.fit_focal, "view": watch.view, "record": watch.record}
        for name, given in unused.items():
            if given:
                raise ValueError(f"--{name}: expected none with --rig, got both")
        check_between("fps", self.fps, 0.0, math.inf)
        if self.camera is None:
            raise ValueError("--rig: expected --camera with the cameras of a moment, got none")
        if not 0 < self.limits <= 180:
            raise ValueError(f"--limits: expected degrees above 0 and up to 180, got {self.limits}")
        if self.mesh.suffix.lower() not in (".glb", ".gltf"):
            raise ValueError(f"MESH: expected a file that ends in .glb or .gltf with --rig, got {self.mesh.name!r}")
