"""`neural-renderer fit`: a textured mesh from images with cameras, a texture, or the camera of one image."""

from __future__ import annotations

import json
import zlib
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from torch import Tensor

from ....camera.files import CameraFile, find_camera_file, read_camera_file
from ....camera.files.opencv import save_cameras
from ....io import save_image
from ....io.atomic_write import write_file
from ....io.images import encode_image
from ....io.obj.writer import check_own
from ....meshes.mesh import Mesh
from ....version import __version__
from ...common.checks import REPORT, check_counts, check_most, check_outputs
from ...common.command import INTERRUPTED, MISMATCH, choose_device, continuing, interruption, say, say_finished
from ...common.geometry.unwrap import LEAST_SIZE, MOST_SIZE, unwrap
from ...common.options import SIZE
from ...common.pictures.animation import save_animation
from ...common.pictures.curve import curve
from ...common.pictures.photograph import turntable
from ...common.task_runner import TaskRunner, setting_value
from ...common.views.load import find_files
from ...common.views.small_copies import copy_paths, save_copies
from ...common.views.up import named_up
from ...pose.command import mask_rule
from ...pose.command import run as run_pose
from ...pose.options import PoseOptions
from ...view.watching import stay, watching
from .. import (
    CameraSettings,
    DescentSettings,
    DetailSettings,
    FitResult,
    MapFormat,
    MeshFit,
    ShapeSettings,
    TextureSettings,
    Views,
    check_agreement,
    load_views,
)
from ..agreement import REFINED_MARGIN
from ..doubts import doubt_colors, doubts
from ..fit_pictures import comparison, upright
from ..options import FitOptions
from ..photos.copies import IMAGES, MASKS, MODEL
from ..photos.found import found_masks, with_backgrounds
from ..photos.masks.shape_masks import SOLID
from ..verdict import Verdict
from .cameras import (
    NO_OBJECT,
    lacks_cameras,
    lacks_masks,
    mask_photographs,
    photographs_beside,
    pose_photographs,
    without_missing,
)
from .surface import SURFACE_SIZE, WHOLE, on_surface, surface_of
from .verdict import Found, known_depth, verdict_lines, verdict_of, verdict_report

if TYPE_CHECKING:
    from ...view.viewer import Viewer

_MAY_DIFFER = (
    *("images", "masks", "output", "steps", "camera_steps", "detail_steps", "texture_steps", "turntable", "unwrap"),
    *("skip_bad", "allow_outside", "cameras", "frames", "masks_only", "resume", "force", "device", "watch", "mask"),
    "object",
)
"""Options that may differ when a fit is resumed. The pixels of the images must be the same."""
_HELPS = {"one side": "--surface", "cut off": "--surface", "two objects": "--masks, --box", "masks": "--masks"}
"""Options that help against what `doubts` finds."""
_SKIP_BAD = "--skip-bad leaves the image out"
_TURNTABLE_SIZE = 256  # side of the pictures in pixels
_TURNTABLE_FPS = 15
_NAMES = {
    "fitted": "fitted",
    "held_out": "held-out",
    "held_out_located": "held-out (with cameras located on the result)",
    "held_out_exposed": "held-out (with exposure matched to the result)",
}
_CAMERAS = "cameras.json"
_RESULTS = ("mesh.obj", "mesh.glb", "preview.png", "comparison.png", "loss.png", "turntable.gif", REPORT, _CAMERAS)
"""Files that a fit may write."""
_PREVIEW_COLUMNS = 4


def run(options: FitOptions) -> int:
    """Fit and write the results; return the exit code: 0, 3 if the result is doubtful, 130 after Ctrl-C."""
    if options.unwrap:  # limits of `unwrap`, before time is spent
        check_counts(options, unwrap=LEAST_SIZE)
        check_most(options, unwrap=MOST_SIZE)
    if options.recover == "camera" and options.mesh is not None:
        return _fit_camera(options, options.mesh)
    with continuing(options.output):
        return _fit_photos(options)


def _fit_photos(options: FitOptions) -> int:
    """Fit to images whose cameras are read or found; return the exit code."""
    if not options.force:
        check_own(options.output / "mesh.obj", None, "--force replaces it")
    outputs = [options.output / name for name in _RESULTS]
    notes: dict[str, Any] = {}
    found: set[str] = set()
    others: list[str] = []
    if lacks_cameras(options):
        posed = pose_photographs(options, mask_rule(options.mask))
        if options.masks_only:
            return 0
        cameras, notes = posed.cameras, {"skipped": posed.missing, "photographs": _all_facts(options, posed.facts)}
        found = set() if posed.is_open or not options.photos else posed.found
        pays = options.recover == "shape" and not (posed.is_exact or posed.is_open or found)
        options = replace(options, surface=posed.is_open, refine_cameras=options.refine_cameras or pays)
        if not posed.is_open:
            options = replace(options, masks=options.output / MASKS)
    else:
        cameras = read_camera_file(find_camera_file(options.images))
        others = photographs_beside(options.images, cameras)
        cameras = without_missing(options, cameras)
        found = found_masks(options.masks or options.images / MASKS) if options.photos else set()
        if lacks_masks(options, cameras, mask_rule(options.mask)):
            posed = mask_photographs(options, cameras)
            if options.masks_only:
                return 0
            cameras, found = posed.cameras, posed.found
            notes = {"skipped": posed.missing, "photographs": _all_facts(options, posed.facts)}
            masks = None if posed.is_open else options.output / MASKS
            options = replace(options, surface=posed.is_open, masks=masks)
    images: list[Path | None] = []
    for entry in cameras.images:
        try:
            images += find_files(cameras, entry, options.masks, options.allow_outside)
        except (OSError, ValueError) as error:
            if not options.skip_bad:
                anew = ", --cameras sfm finds cameras anew" if len(others) > len(cameras.images) / 2 else ""
                error.args = (f"{error}; {_SKIP_BAD}{anew}",)
                raise
    *copies, posed_copies = copy_paths(options.output, len(images))
    check_outputs(copies, images)  # apart, as a camera file is searched for each output that is there
    check_outputs([*outputs, posed_copies], [cameras.path, *images, options.mesh])
    if others:
        got = f"{cameras.path} has cameras of {len(cameras.images)} images, but not of {len(others)} more"
        say(f"{got} ({others[0]}, for example); --cameras sfm finds those of all", "yellow")
    return _fit_mesh(options, cameras, notes, found)


def _all_facts(options: FitOptions, facts: dict[str, Any]) -> dict[str, Any]:
    """Merge the facts about photographs from the report of the run that is resumed."""
    file = options.output / REPORT
    if not (options.resume and file.is_file()):
        return facts
    earlier = json.loads(file.read_text(encoding="utf-8")).get("photographs", {})
    earlier.pop(NO_OBJECT, None)  # which is found again, unless a surface is requested now
    return facts | earlier | {"seconds": round(facts["seconds"] + earlier.get("seconds", 0), 1)}


def _fit_mesh(options: FitOptions, cameras: CameraFile, notes: dict[str, Any], found: set[str]) -> int:
    """Fit a mesh, or the texture of a known mesh; return the exit code.

    The notes are for the report. Images whose masks were ``found`` automatically are compared as whole images.
    """
    bad: dict[str, str] = {}
    try:
        views = load_views(
            cameras,
            size=options.size or (SURFACE_SIZE if options.surface else SIZE),
            photos=options.photos,
            masks=options.masks,
            box=options.box,
            maps=options.maps,
            map_format=MapFormat(options.normals_in, options.depth_scale),
            allow_outside=options.allow_outside,
            rule=WHOLE if options.surface else mask_rule(options.mask),
            scenes=bool(found),
            bad=bad if options.skip_bad else None,
        )
    except (OSError, ValueError) as error:
        if hasattr(error, "image"):
            error.args = (f"{error}; {_SKIP_BAD}",)
        raise
    views = views.to(choose_device(options.device))
    options = replace(options, light=options.light or _light(options, views))
    for name, why in bad.items():
        say(f"{name} is skipped: {why}", "yellow")
    notes |= {"skipped": bad | notes.get("skipped", {})}
    cameras = replace(cameras, images=[entry for entry in cameras.images if entry.name not in bad])
    sentences: list[str] = []
    if options.check and not options.surface:
        if not found:  # else the doubts say it, and no file of cameras is wrong
            _check(views, cameras, options)
        wrong = {about: sentence for about, sentence in doubts(views).items() if not (found and about == "masks")}
        sentences = [f"{sentence} ({_HELPS[about]})" for about, sentence in wrong.items()]
        for sentence in sentences:
            say(sentence, "yellow")
    context: Found | None = None
    if found:
        taken = [entry.name for entry in cameras.images]
        depth = known_depth(options, taken)
        context = Found(views, taken, cameras.points, depth, sentences)
        if cameras.points is not None:
            rows = [row for row, name in enumerate(taken) if name in found]
            views = with_backgrounds(views, cameras.points, rows, None if depth is None else depth[1])
    kept, left = _split(len(views), options.held_out)
    start: Literal["hull", "sphere"] | Mesh = options.start
    if options.surface:
        start, views = surface_of(options, cameras, views, kept)
        options = replace(options, recover="texture", detail_steps=None, light=None)
    fitted, held_out = (views[kept], views[left]) if left else (views, None)
    names = [cameras.images[row].name for row in kept]
    if found and start == "hull" and (options.output / SOLID).is_file():
        start = Mesh.load(
            options.output / SOLID, texture_size=2
        )  # a hull would be filled where no outline shows hollows
    if options.mesh is not None:
        start = Mesh.load(options.mesh, texture_size=2, allow_outside=options.allow_outside)
    with watching(options.watch) as viewer:
        if viewer is not None:
            viewer.set_up(options.up or named_up(fitted))
            viewer.show_cameras(fitted.camera, fitted.photos, fitted.masks)
        return _run_mesh_fit(options, fitted, held_out, names, notes, start, viewer, context)


def _light(options: FitOptions, views: Views) -> Literal["fitted"] | None:
    """Choose the default of ``light``: details follow the colours of photos, unless maps show them better."""
    is_shape = options.recover == "shape" and not options.surface and options.detail_steps != 0
    has_maps = views.normals is not None or views.depth is not None
    return "fitted" if is_shape and views.photos is not None and not has_maps else None


def _run_mesh_fit(
    options: FitOptions,
    fitted: Views,
    held_out: Views | None,
    names: list[str],
    notes: dict[str, Any],
    start: Literal["hull", "sphere"] | Mesh,
    viewer: Viewer | None,
    context: Found | None,
) -> int:
    """Fit a mesh to views with names, and write the results, with notes; return the exit code."""
    fit = MeshFit(
        fitted,
        start,
        recover="texture" if options.recover == "texture" else "shape",
        exposure=options.exposure,
        shape=ShapeSettings(options.steps, options.cells, options.color_from, options.weights),
        detail=DetailSettings(options.detail_steps, options.light, options.detail_weights),
        texture=TextureSettings(options.texture_steps, options.texture_size),
        cameras=CameraSettings(options.refine_cameras, options.camera_steps),
        descent=DescentSettings(options.batch, options.gradient, options.seed),
    )
    runner = _runner(options, fit, fitted, viewer)
    finished = runner.run(options.resume)
    if not finished:
        _add_texture(fit)
    _write_mesh(options, fit, fitted)
    camera = fit.cameras() if options.refine_cameras else None
    if camera is not None and camera.perspective and not camera.is_fisheye:
        files = [name if not (options.output / IMAGES / name).is_file() else f"{IMAGES}/{name}" for name in names]
        save_cameras(options.output / _CAMERAS, camera, files, fit.views.size)
    if not (options.output / MODEL).is_dir():  # else the copies of photographs are there, with their cameras
        save_copies(options.output, camera or fitted.camera, fitted)
    result = fit.result(held_out)
    doubt = doubt_colors(fit.views, fit.shape) if len(fit.shape) == 3 else None
    if doubt:
        say(doubt, "yellow")
    if options.surface:
        result = on_surface(result, fitted, held_out)
    verdict = verdict_of(result, options, context, doubt, notes.get("photographs", {}))
    _report(options, runner, fit, result, finished, names, notes | verdict_report(verdict), verdict)
    stay(viewer, finished or runner.stopped)
    if not (finished or runner.stopped):
        return INTERRUPTED
    return MISMATCH if verdict.reasons else 0


def _add_texture(fit: MeshFit) -> None:
    """Fit the texture of a fit that was ended early. The checkpoint, written before, keeps the earlier phase."""
    try:
        if fit.phase == "texture" or not fit.skip_to_texture():
            return
    except ValueError as error:
        say(str(error), "yellow")
        return
    say("the texture of this shape follows; Ctrl-C leaves it out")
    with interruption() as interrupted:
        while not fit.done and not interrupted:
            fit.advance()


def _fit_camera(options: FitOptions, file: Path) -> int:
    """Find the camera of one image of the mesh in a file, by the command `pose`; return the exit code."""
    names = ["output", "viewing_angle", "photos", "size", "allow_outside", "force", "watch", "mask"]
    same = {name: getattr(options, name) for name in names if name != "size" or options.size}
    pose = PoseOptions(mesh=file, images=(options.images,), **same)
    pose.validate()
    return run_pose(pose)


def _check(views: Views, cameras: CameraFile, options: FitOptions) -> None:
    """Raise ValueError, which names the path that was given, if masks and cameras do not agree."""
    try:
        margin = REFINED_MARGIN if options.refine_cameras else 1
        check_agreement(views, [entry.name for entry in cameras.images], margin)
    except ValueError as error:
        text = str(error).removeprefix("views: ")
        if cameras.path.is_relative_to(options.output):  # found, so that no file of cameras is wrong
            text = f"{text.rpartition('; ')[0]}; the masks may be wrong, or the object moved"
        raise ValueError(f"{options.images}: {text}. --no-check fits anyway") from None


def _runner(options: FitOptions, fit: MeshFit, views: Views, viewer: Viewer | None) -> TaskRunner:
    """Make the runner of a fit, identified by the values of the tensors of its views."""
    named = asdict(options) | asdict(options.mask)
    settings = {name: setting_value(value) for name, value in named.items() if name not in _MAY_DIFFER}
    camera = (getattr(views.camera, part.name) for part in fields(views.camera))
    settings["images"] = (
        f"#{_checksum((views.masks, views.photos, views.normals, views.depth, views.scenes, *camera)):08x}"
    )

    def preview(path: Any) -> None:
        write_file(path, encode_image(path, comparison(fit.views, fit.shape, columns=_PREVIEW_COLUMNS), fast=True))

    device = choose_device(options.device)
    return TaskRunner(options.output, fit, settings, preview, device=device, observer=viewer, mesh=fit.mesh)


def _checksum(images: tuple[Any, ...]) -> int:
    value = 0
    for part in images:
        if isinstance(part, Tensor):
            for row in part if part.ndim else part[None]:  # one by one, to save memory
                value = zlib.crc32(row.detach().cpu().contiguous().numpy(), value)
    return value


def _split(count: int, every: int) -> tuple[list[int], list[int]]:
    """Hold out every n-th view: return the indices of the fitted views, then of the held-out ones."""
    if not every:
        return list(range(count)), []
    rows = list(range(every - 1, count, every))
    if not rows:
        raise ValueError(f"--held-out: expected at most {count}, the number of views, got {every}")
    return [index for index in range(count) if index not in rows], rows


def _write_mesh(options: FitOptions, fit: MeshFit, views: Views) -> None:
    """Write a fitted mesh and pictures of it; ``views`` are in the world of the mesh."""
    folder, mesh = options.output, fit.mesh()
    written = unwrap(mesh, options.unwrap) if options.unwrap else mesh
    written.save(folder / "mesh.obj", overwrite=options.force)
    written.save(folder / "mesh.glb")
    save_image(folder / "comparison.png", comparison(fit.views, fit.shape))
    if options.turntable:
        pictures = turntable(upright(mesh, views, options.up), options.turntable, size=_TURNTABLE_SIZE)
        save_animation(folder / "turntable.gif", pictures, fps=_TURNTABLE_FPS)


def _report(
    options: FitOptions,
    runner: TaskRunner,
    fit: MeshFit,
    result: FitResult,
    finished: bool,
    names: list[str],
    notes: dict[str, Any],
    verdict: Verdict,
) -> None:
    """Write ``report.json`` of a fit of the images with these names, and the losses; print a summary."""
    mesh, gains = result.mesh, fit.views.gains
    results: dict[str, Any] = {"views": len(fit.views), "vertices": len(mesh.vertices), "faces": len(mesh.faces)}
    results |= {name: note for name, note in notes.items() if note}
    seconds = runner.seconds + notes.get("photographs", {}).get("seconds", 0)
    if gains is not None:
        rows = [[round(gain, 4) for gain in row] for row in gains.tolist()]
        results["gains"] = dict(zip(names, rows, strict=True))
        results["vignetting"] = round(fit.vignetting, 4)
    for name in _NAMES:
        if figures := getattr(result, name):
            results[name] = {
                measure: {"mean": round(values.mean().item(), 4), "least": round(values.min().item(), 4)}
                for measure, values in figures.items()
            }
    report = {
        "version": __version__,
        "recover": options.recover,
        "inputs": {
            "images": str(options.images.resolve()),
            "mesh": None if options.mesh is None else str(options.mesh.resolve()),
            "photos": options.photos,
            "maps": options.maps,
            "background": options.mask.background,
        },
        "gradient": options.gradient,
        "finished": finished,
        "seconds": round(seconds, 1),
        **results,
        "changes": runner.changes,
        "history": runner.history,
    }
    write_file(options.output / REPORT, json.dumps(report, indent=1) + "\n")
    if runner.history:
        save_image(options.output / "loss.png", curve(runner.history, "loss", "iou"))
    first, *others = verdict_lines(verdict)
    say(f"[bold]{first}[/bold]", markup=True)
    for line in others:
        say(line, "red")
    against = " (against masks that were found)" if verdict.is_of_found else ""
    for name in _NAMES:
        if name in results:
            numbers = ", ".join(f"{measure} {value['mean']:.4f}" for measure, value in results[name].items())
            say(f"{_NAMES[name]} views{against}: [bold]{numbers}[/bold]", markup=True)
    say_finished(seconds, options.output, None if finished else len(runner.history))
