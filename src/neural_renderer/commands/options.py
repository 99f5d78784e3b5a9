"""Options of the commands and their help texts. This module does not import torch, so that `--help` is fast.

The class `RenderOptions` belongs to the command `commands.render`, and so on.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal, get_args

import tyro

from ..tasks.settings import DREAM_LAYER, STYLE_LAYERS, DetailWeights, FitWeights


@dataclass(frozen=True, kw_only=True)
class WatchOptions:
    """Follow the run."""

    view: bool = False
    """Show the mesh in the browser while it changes, with curves, pause, stop and settings. Needs viser (pip install
    viser)."""
    host: str = "127.0.0.1"
    """Name or address of this machine to listen on, for --view. Everybody who reaches another address sees the meshes
    and can stop the run."""
    port: int = 8080
    """First port to try, for --view; the next free one is taken. 0: any."""
    record: Path | None = None
    """HTML file that keeps the frames and that any browser opens, without Python."""
    record_limit: float = 32.0
    """Size of that file in MiB at most (at least 1)."""


@dataclass(frozen=True, kw_only=True)
class MaskOptions:
    """Cut the object out of pictures without transparency or mask."""

    background: tuple[float, float, float] | None = None
    """Red, green and blue (0 to 1) of the background."""
    tolerance: float = 0.05
    """Largest difference from --background, in any channel (0 to 1), of a background pixel."""
    mask_below: float | None = None
    """Pixels whose brightest channel is below this (0 to 1) are background."""
    mask_open: int = 0
    """Remove parts of such masks that are thinner than this radius in pixels."""
    mask_close: tuple[int, int] = (0, 0)
    """Dilate such masks by the first radius in pixels, then erode them by the second, which fills gaps."""
    mask_fill: float = 0.0
    """Fill holes of such masks that are smaller than this share (0 to 1) of the object: shadows and highlights."""


Output = Annotated[Path, tyro.conf.arg(aliases=["-o", "--out"])]
Watch = Annotated[WatchOptions, tyro.conf.arg(name="")]
Mask = Annotated[MaskOptions, tyro.conf.arg(name="")]
Device = Annotated[
    Literal["auto", "cpu", "cuda"], tyro.conf.arg(help="Device to compute on; auto is CUDA if available.")
]
AllowOutside = Annotated[
    bool,
    tyro.conf.arg(help="Allow files to name images and materials outside of their folders. For trusted files only."),
]
Saved = Literal["rgb", "alpha", "depth", "normal", "position", "uv", "face_index", "barycentric"]
SAVED = get_args(Saved)


@dataclass(frozen=True)
class RenderOptions:
    """Draw mesh files as pictures (.png, .jpg) or animations (.gif, .mp4), or save what the pixels show.

    Example: neural-renderer render bunny.obj -o bunny.png --size 512

    Example: neural-renderer render bunny.obj -o bunny.gif --turntable 60

    Example: neural-renderer render models -o pictures --turntable 24

    Example: neural-renderer render chair.glb table.glb -o room.png --camera cameras.json --background room.jpg

    Example: neural-renderer render helmet.glb -o helmet.png --shading pbr --environment studio.hdr

    Example: neural-renderer render bunny.obj --save depth depth.png normal normal.exr position position.npy

    Example: neural-renderer render fox.glb --animate fox.gif --animation Walk
    """

    meshes: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="MESH", name="MESH")]
    """Mesh files: .obj, .ply, .stl, .off, .glb or .gltf, or folders of such. Several are drawn as one scene, or, if the
    output is a folder or has %s in its name, each for itself."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o", "--out"])] = None
    """Picture to write: .png or .jpg; .gif or .mp4 for an animation; a folder for the pictures of models or of a
    turntable. In a name, %s is the name of a model, and %03d the number of a view: one of a turntable, or of a camera
    in the file. An existing file is replaced, but not a texture of a mesh."""
    save: Annotated[tuple[tuple[Saved, Path], ...], tyro.conf.arg(metavar="OUTPUT FILE …")] = ()
    """Outputs and the files to write: .npy, .exr (pip install OpenEXR), or .png for all but position, uv and
    face_index. rgb and alpha are anti-aliased, the others are those at the pixels' centres; 0 where no face is visible,
    -1 for face_index. Normals (smooth) and positions are in world space; depth is along the viewing axis."""
    depth_scale: float = 1000.0
    """Steps of a 16-bit depth .png for one unit of the model (above 0): with 1000, metres are stored in millimetres."""
    camera: Path | None = None
    """Camera file, in place of the angles below: transforms.json, cameras.json or cameras.csv as for `fit`; the
    report.json of `pose`; or JSON with K, R, t, width and height, or with matrices. The page on cameras
    describes all. The model is not normalised. A picture shows one camera, an animation all."""
    frame: int = 0
    """Number of the camera in the file, from 0, for a picture."""
    size: int | tuple[int, int] | None = None
    """Side of the picture, or height and width, in pixels (1 to 32768). By default the size in the camera file, or that
    of the background photograph, or 512."""
    azimuth: float = 150.0
    """Position of the camera around the y axis in degrees: 180 is at +z, in front of most models; 90 at +x; 0 at -z."""
    elevation: float = 20.0
    """Elevation of the camera in degrees (above -90, below 90); positive is above the model."""
    distance: float | None = None
    """Distance of the camera from the origin in units of the model (above 0). By default the whole model is visible."""
    viewing_angle: float = 20.0
    """Half of the vertical field of view in degrees (above 0, below 90)."""
    orthographic: bool = False
    """Use orthographic projection. Distance and viewing angle then do not change sizes."""
    mode: Literal["rgb", "silhouettes", "depth", "normals"] = "rgb"
    """Content of the picture. rgb: colours; silhouettes: white on black; depth: near is bright; normals: in camera
    space, red to the right, green up, blue towards the viewer."""
    turntable: int | None = None
    """Number of pictures of a turntable (at least 1), from the azimuth on. 60 by default for an animation."""
    time: float | None = None
    """Time in seconds of the animation of a .glb or .gltf file; constant beyond its ends. By default the file's pose at
    rest, without joints."""
    animate: Path | None = None
    """Animation (.gif, .mp4, or numbers such as %03d.png) of the model's own motion, in place of the output."""
    animation: str | None = None
    """Name or number of the file's animation, for time and animate. The first by default."""
    fps: float = 20.0
    """Pictures per second of an animation (above 0)."""
    background: Literal["white", "black", "transparent", "environment"] | tuple[float, float, float] | Path | None = (
        None
    )
    """Background of the modes rgb and normals: a name; red, green and blue from 0 to 1; or a photograph, which is
    scaled to the picture. Transparent needs .png, and environment the option of this name. The default is white."""
    light: bool = True
    """Light the model from over the viewer's shoulder. Without light, colours are drawn unchanged."""
    environment: Path | None = None
    """Image of the surroundings (equirectangular: .hdr, .exr, .jpg, …) that lights the model in place of this lamp."""
    shading: Literal["flat", "smooth", "phong", "pbr"] | None = None
    """Light on faces as a whole (flat), or on each pixel, with smooth normals and normal maps: matt (smooth), with
    highlights (phong), or with metal and roughness of the file's materials (pbr). By default smooth for meshes with
    normals and for those that have hardly any creases, else flat."""
    layers: int | None = None
    """Number of faces that are blended at each pixel (at least 1), for transparent and cut-out materials; 4 is enough
    for two bodies, one behind the other. By default all faces are opaque."""
    normalize: bool = True
    """Move the model to the origin and scale its longest side to 2 units. Several meshes are moved together."""
    texture_size: int | None = None
    """Bake colours into textures with this number of texels along the edge of a face (at least 1), as `Mesh.load` does.
    By default the images of the file are used directly."""
    allow_outside: AllowOutside = False
    device: Device = "auto"


@dataclass(frozen=True)
class InfoOptions:
    """Show versions and devices, and check a small image and its gradient on each device.

    Example: neural-renderer info
    """


@dataclass(frozen=True)
class FitOptions:
    """Recover a textured mesh from photographs, the texture of a known mesh, or the camera of one image.

    IMAGES is a folder of photographs, or a video; their cameras are found first (pip install pycolmap). Or it is a
    folder with cameras, or their file: transforms.json (NeRF, Blender, nerfstudio), cameras.json (K, R, t, or distances
    and angles), cameras.csv, a model of COLMAP (sparse/0), *_par.txt (Middlebury). For --recover camera it is one
    image.

    Example: neural-renderer fit photos -o out

    Example: neural-renderer fit wall -o out --surface

    Example: neural-renderer fit photos -o out --recover texture --mesh bunny.obj

    Example: neural-renderer fit photo.png -o out --recover camera --mesh bunny.obj

    Ctrl-C ends the fit and writes the current result; --resume continues it.
    """

    images: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="IMAGES")]
    """Folder of the images, their camera file, or a video; one image for --recover camera."""
    output: Output
    """Folder for the results; it is made if missing."""
    cameras: Literal["sfm", "file"] | None = None
    """Source of the cameras. sfm: structure from motion, which writes images, masks and sparse/0 into the output; file:
    the camera file. By default the file, and sfm if there is none."""
    frames: int = 60
    """Frames of a video to use (at least 8): sharp ones, spaced by how much the picture changes."""
    surface: bool = False
    """Make an open mesh of all that the photographs show, for what has no outline: a wall, a relief, a room. Needs
    points of structure from motion. Photographs without cameras in which no object stands out need no such hint."""
    recover: Literal["shape", "texture", "camera"] = "shape"
    """Target of the fit. shape: the shape, then the texture if there are photos; texture: the texture of a known mesh;
    camera: the camera of one image, as `pose` does."""
    mesh: Path | None = None
    """Initial mesh, or the known mesh for --recover texture or camera, in the world of the cameras."""
    start: Literal["hull", "sphere"] = "hull"
    """Initial shape without --mesh: the visual hull of the silhouettes, with its holes and handles, or a sphere."""
    cells: int | None = None
    """Grid cells along each axis for the visual hull (at least 8). More cells open narrower holes and gaps, and make
    more faces; by default 64, and 96 or 128 where that opens holes or gaps that several masks show."""
    photos: bool = True
    """Use the colours of the images. Without photos, images are silhouettes."""
    masks: Path | None = None
    """Folder of masks, white on black, named like the images; by default the folder masks beside them, if there is
    one. Images without transparency or mask are cut out by the options for masks, else from a plain background."""
    masks_only: bool = False
    """End when the masks of photographs without cameras are found. masks.jpg shows them; correct those in the folder
    masks of the output, and read them with --masks. If there are none, that is an error."""
    mask: Mask = field(default_factory=MaskOptions)
    box: tuple[float, float, float, float, float, float] | None = None
    """Opposite corners (x y z x y z) of a box around the object, in the world of the cameras. What is outside is
    background."""
    maps: bool = True
    """Use the maps in the folders normals and depth beside the images, if there are such: a .png or .npy for each
    image, as render --save writes them. They show details and hollows that outlines do not show."""
    normals_in: Literal["world", "camera"] = "world"
    """Space of the normal maps. camera: x right, y up, z towards the viewer."""
    depth_scale: float = 1000.0
    """Steps of a 16-bit depth .png for one unit of the world (above 0); 0 in the .png is no depth."""
    skip_bad: bool = False
    """Leave out images that cannot be used, such as damaged or missing ones, as long as at least half of them remain.
    They are named, also in report.json. By default the first one ends the fit."""
    check: bool = True
    """Check first whether masks and cameras agree, and end with an error if they do not."""
    up: tuple[float, float, float] | None = None
    """Direction that is up in the world of the cameras, for the turntable; by default it is told from the cameras."""
    size: int | None = None
    """Scale larger images down to this longer side in pixels (at least 16); by default 256, and 800 for a surface."""
    held_out: int = 0
    """Hold out every n-th view for the report (at least 2; 0: none)."""
    steps: int = 150
    """Steps of gradient descent for the shape (at least 1)."""
    detail_steps: int | None = None
    """Steps for normals, depth and, with --light, colours, after those for the shape, which remesh it (at least 0); by
    default 200 if there are such maps or --light."""
    light: Literal["fitted", "none"] | None = None
    """Let details follow the colours of the photos, too. fitted: with a light that was the same in all photos, which is
    fitted along; none: without one, for photos whose light moved, and for objects with a pattern."""
    texture_steps: int = 20
    """Steps of conjugate gradients for the texture (at least 1)."""
    texture_size: int = 4
    """Texels along the edge of a face's texture (at least 3)."""
    batch: int = 6
    """Views per step (at least 1)."""
    viewing_angle: float = 30.0
    """Half of the vertical field of view in degrees, for --recover camera (above 0, below 90)."""
    gradient: Literal["edge", "nmr"] = "edge"
    """Gradient estimator of the renderer."""
    refine_cameras: bool = False
    """Fit the poses of the cameras and their focal length, too, for cameras that are not exact: about 1° and 1% off.
    The result has a file cameras.json. Cameras from structure from motion with few points are always refined."""
    camera_steps: int = 150
    """Steps for the cameras before those for the shape (at least 1), for up to 24 views; more views take more."""
    exposure: bool = False
    """Fit the exposure and white balance of each photo, too, for photos that a camera exposed automatically. The report
    has the factors of red, green and blue."""
    color_from: Annotated[float | None, tyro.conf.arg(aliases=["--colour-from"])] = None
    """After this fraction of the steps (0 to 1), colours move the shape, too. Silhouettes do not show hollows; 0.3
    recovers some of them, in twice the time. By default 1, which is never, and 0.4 with --refine-cameras."""
    weights: FitWeights = field(default_factory=FitWeights)
    """Weights of the losses."""
    detail_weights: DetailWeights = field(default_factory=DetailWeights)
    """Weights of the losses of the steps for normals and depth."""
    unwrap: int = 0
    """Side in pixels of one texture image with large charts (16 to 8192; needs xatlas: pip install xatlas); 0: the
    image has a small tile for each face."""
    turntable: int = 36
    """Pictures of the turntable (0: none)."""
    seed: int = 0
    """Seed of the order of the views."""
    allow_outside: AllowOutside = False
    resume: bool = False
    """Resume from the checkpoint in the output folder, if there is one. Images and options must be the same, except for
    numbers of steps."""
    force: bool = False
    """Replace what is in the output folder: the results of an earlier run, and mesh.mtl and mesh_texture.png even if
    another program wrote them."""
    device: Device = "auto"
    watch: Watch = field(default_factory=WatchOptions)


@dataclass(frozen=True, kw_only=True)
class PoseOptions:
    """Find the pose of a known object in pictures: from photos, masks or depth, without a first guess.

    IMAGE is a picture or a folder of them, in the order of their names. Each has a pose of its own, and the last pose
    starts the next, as in a film. With --camera, they show one pose from known cameras.

    The folder OUTPUT gets report.json with the poses, cameras.json with cameras in the world of the mesh, which
    `render --camera` reads, overlay.png with the outlines of the object drawn on the pictures, and preview.png.

    Example: neural-renderer pose spot.obj photo.png -o pose --viewing-angle 20

    Example: neural-renderer pose drill.glb frames -o track --masks masks --hidden

    With --rig, joints of a .glb or .gltf file are turned, too, from known cameras. OUTPUT gets rig.glb, whose animation
    "found" is what was found, in place of cameras.json and preview.png.

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
    """Fit the focal length of each picture, from --viewing-angle on, which may be wrong by a third."""
    camera: Path | None = None
    """Camera file, as of `render`: the pictures, in the order of its cameras, show one pose."""
    rig: bool = False
    """Turn the joints. Pictures are those of --camera at each moment, one moment after the other."""
    keypoints: Path | None = None
    """With --rig, JSON of joints in the pictures: a list with an object for each, such as
    [{"hand_l": [10.5, 20, 1]}], of x and y in pixels and a weight."""
    limits: float = 90.0
    """With --rig, largest angle of a joint from rest, about each of its axes, in degrees (above 0, up to 180)."""
    shape: bool = False
    """With --rig, find the weights of morph targets, too."""
    fps: float = 20.0
    """With --rig, moments per second (above 0)."""
    photos: bool = True
    """Use the colours of the pictures. Without photos, pictures are silhouettes, white on black."""
    hidden: bool = False
    """Other things may hide parts of the object, so that masks show only what is visible of it. A match may be wrong
    where that does not determine the pose."""
    masks: Path | None = None
    """Folder of masks, white on black, named like the pictures. Pictures without transparency or mask are cut out by
    the options for masks below, else from a plain background."""
    depth: Path | None = None
    """Folder of depth images, .png of 16 bits or .npy, named like the pictures."""
    depth_scale: float = 1000.0
    """Steps of a 16-bit depth .png for one unit of the mesh (above 0); 0 in the .png is no depth."""
    mask: Mask = field(default_factory=MaskOptions)
    size: int = 256
    """Scale larger pictures down to this longer side in pixels (at least 16)."""
    allow_outside: bool = False
    """Allow the mesh file to name materials and images outside of its folder. For trusted files only."""
    force: bool = False
    """Replace the results of an earlier run in the output folder."""
    watch: Watch = field(default_factory=WatchOptions)


@dataclass(frozen=True, kw_only=True)
class EditOptions:
    """Options of both commands. The preset replaces None."""

    mesh: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MESH")]
    """Mesh file: .obj, .ply, .stl, .off, .glb or .gltf."""
    output: Output
    """Folder for the results; it is made if missing."""
    preset: Literal["paper", "published"] = "paper"
    """Default settings. paper: the paper's, with losses that suit any network and mesh; published: the settings of the
    published code, for the paper's network only."""
    weights: Path | None = None
    """File with the weights of the network, .safetensors or .pth. By default they are downloaded once."""
    steps: int | None = None
    """Number of steps (at least 1); by default the preset's."""
    batch: int = 4
    """Views per step (at least 1)."""
    size: int = 224
    """Side in pixels of the images for the network (at least 32). Smaller is faster and gives larger patterns."""
    vertex_rate: float | None = None
    """Learning rate of the vertices (0: fixed); by default the preset's."""
    texture_rate: float | None = None
    """Learning rate of the colours (0: fixed); by default the preset's."""
    settle: float | None = None
    """Both learning rates decay to 0 in this last fraction of the steps (0 to 1); by default the preset's."""
    elevation: tuple[float, float] | None = None
    """Least and greatest elevation of the camera in degrees (between -90 and 90); by default the preset's."""
    distance: float | None = None
    """Distance of the camera from the centre of the mesh, whose longest side is 2; by default the preset's."""
    init: Literal["mesh", "random"] | None = None
    """Initial colours. mesh: the mesh's own, or, for a mesh without colours, the painting's mean colour (style) or grey
    (dream); random: grey with noise. By default the preset's."""
    texture_size: int = 4
    """Texels along the edge of a face's texture (at least 3, or 1 if not seamless). Meshes with few faces need more."""
    uv: int | None = None
    """Keep the texture coordinates of the file and paint its images, each with this many pixels a side (at least 16).
    For meshes with few, large faces and an image. --texture-size and --seamless are ignored. By default faces get new
    texels and texture coordinates."""
    seamless: bool | None = None
    """Share texels on edges between adjacent faces, so that there are no seams; by default the preset's."""
    bend: float | None = None
    """Weight of the bending loss. It makes adjacent vertices move alike. By default the preset's."""
    variation: float | None = None
    """Weight of the total variation of the images; by default the preset's."""
    gradient: Literal["nmr", "edge"] = "nmr"
    """Gradient estimator of the renderer; nmr is the paper's."""
    preview: int = 50
    """Steps between two previews and checkpoints (at least 1)."""
    turntable: int = 36
    """Pictures of the turntable (0: none)."""
    seed: int = 0
    """Seed of the views and of random colours."""
    allow_outside: AllowOutside = False
    resume: bool = False
    """Resume from the checkpoint in the output folder, if there is one. Files and settings must be the same."""
    force: bool = False
    """Replace what is in the output folder: the results of an earlier run, and mesh.mtl and mesh_texture.png even if
    another program wrote them."""
    device: Device = "auto"
    watch: Watch = field(default_factory=WatchOptions)


@dataclass(frozen=True, kw_only=True)
class StyleOptions(EditOptions):
    """Transfer the style of a painting to the texture and the shape of a mesh.

    Images of the mesh from all sides are optimised to have the painting's feature statistics in layers of a VGG. The
    weights of VGG-16 are downloaded once (528 MB); --weights reads others.

    Example: neural-renderer style bunny.obj starry_night.jpg -o out

    Example: neural-renderer style teapot.obj wave.jpg -o out --steps 400 --size 160 --weights vgg19.safetensors

    Preset paper: 5000 steps, learning rates 2.5e-4 and 0.05, elevations 20 to 40, distance 2.732, light 0.75 and 0.5,
    the mesh's colours. Preset published: 1000 steps, learning rates 5e-4 and 0.05, light 0.5 and 0.5, random colours,
    not seamless.

    Ctrl-C ends the run and writes the current result; --resume continues it.
    """

    painting: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="PAINTING")]
    """Picture with the style: PNG, JPEG or any other format that Pillow reads."""
    content: float | None = None
    """Weight of the content loss. It keeps vertices near their initial positions. By default the preset's."""
    palette: float | None = None
    """Weight of the palette loss. It penalises colours outside the painting's palette. By default the preset's."""
    light: tuple[float, float] | None = None
    """Ambient and directional intensity of the light; by default the preset's."""
    painting_scale: float = 1.0
    """Size of the painting relative to the images of the mesh (above 0). 2 makes its strokes twice as large."""
    layers: tuple[str, ...] = STYLE_LAYERS
    """Layers of the network for the comparison of feature statistics."""


@dataclass(frozen=True, kw_only=True)
class DreamOptions(EditOptions):
    """Apply DeepDream to the texture and the shape of a mesh.

    Images of the mesh from all sides are optimised for large activations in a layer of GoogLeNet. torchvision's weights
    are downloaded once (50 MB); --weights reads others.

    Example: neural-renderer dream bunny.obj -o out

    Example: neural-renderer dream teapot.obj -o out --layer inception_4d --channel 3 --weights googlenet.safetensors

    Preset paper: 1000 steps, learning rates 5e-5 and 0.01, elevations -10 to 30, distance 2.5, the mesh's colours.
    Preset published: learning rates 1e-4 and 0.01, random colours, not seamless.

    Ctrl-C ends the run and writes the current result; --resume continues it.
    """

    layer: str = DREAM_LAYER
    """Layer of the network; its activations are maximised."""
    channel: int | None = None
    """Channel of the layer, from 0; by default all."""


@dataclass(frozen=True)
class ViewOptions:
    """Show meshes, the results of a command, or a record in the browser.

    A file is a mesh or a record (.html); several meshes stand side by side. A folder is the output of `fit`, `style`,
    `dream` or `reconstruct`, or one of meshes: what went in, what came out, pictures, curves, cameras with their
    photographs, and a slider through the frames of a record. Needs viser (pip install viser).

    Example: neural-renderer view bunny.obj teapot.obj

    Example: neural-renderer view out

    Example: neural-renderer view bunny.obj --record bunny.html --no-browser

    On another machine: ssh -L 8080:127.0.0.1:8080 MACHINE, run it there, and open http://127.0.0.1:8080 here. Ctrl-C
    ends it.
    """

    paths: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FILE|FOLDER")]
    """One or more mesh files, or one record or folder."""
    host: str = "127.0.0.1"
    """Name or address of this machine to listen on. Everybody who reaches another address sees the meshes."""
    port: int = 8080
    """First port to try; the next free one is taken. 0: any."""
    up: Literal["+x", "-x", "+y", "-y", "+z", "-z"] | None = None
    """Axis that is up; by default +y, or the one of the cameras."""
    record: Path | None = None
    """HTML file to write what is shown to. It needs neither Python nor a network."""
    browser: bool = True
    """Open a port for browsers. Without, only the record is written."""
    allow_outside: AllowOutside = False


@dataclass(frozen=True)
class DemoOptions:
    """Render a turntable of a textured knot, fit a sphere to 24 silhouettes of a duck, and make a mesh of one picture.

    Needs no downloads.

    Example: neural-renderer demo -o out
    """

    output: Output = Path("out")
    """Folder for the results; it is made if missing."""
    frames: int = 48
    """Pictures of the turntable (at least 1)."""
    size: int = 320
    """Side of the pictures in pixels (at least 32)."""
    steps: int = 300
    """Steps of gradient descent for the shape (at least 1)."""
    views: int = 24
    """Silhouettes to fit (at least 1)."""
    view_size: int = 96
    """Side of the silhouettes in pixels (at least 16)."""
    seed: int = 0
    """Seed of the order of the views."""
    device: Device = "auto"


@dataclass(frozen=True)
class RunOptions:
    """Run a Python program as it is: `nvdiffrast.torch` is this package's where nvdiffrast is not installed, and on a
    machine without CUDA what the program does on "cuda" happens on the CPU.

    All arguments after the program are its own.

    Example: neural-renderer run fit.py --resolution 256
    """

    program: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="PROGRAM", name="PROGRAM")]
    """Python file, or with -m the name of a module."""
    device: Annotated[Literal["auto", "cpu"], tyro.conf.arg(help="Where CUDA happens; auto is CUDA if available.")] = (
        "auto"
    )
    ours: bool = False
    """Use this package's nvdiffrast.torch even where nvdiffrast is installed."""
    module: Annotated[bool, tyro.conf.arg(aliases=["-m"])] = False
    """Run a module, as python -m does."""
    arguments: tyro.conf.Suppress[tuple[str, ...]] = ()
