"""Names of the pictures of several models and views: %s stands for a model, %d or %03d for the number of a view."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from ...camera.files.load import load_cameras
from ...io.formats import MESH_SUFFIXES
from ...raster.settings import image_size
from .options import NUMBER, RenderOptions

_MODEL = "%s"


def scenes(options: RenderOptions) -> list[RenderOptions]:
    """Return the options of each scene: one with all models, or one for each model if the names contain %s.

    Raises ValueError if the pictures of two models would have one name, or a folder has no models.
    """
    if options.animate is not None:
        options = replace(options, output=options.animate)
    models = [model for path in options.meshes for model in _models(path)]
    output = options.output
    if output is not None and (output.is_dir() or not output.suffix):
        output /= (_MODEL if not _has_views(options) else f"{_MODEL}/%03d" if len(models) > 1 else "%03d") + ".png"
    written = [path for path in (output, *(path for _, path in options.save)) if path is not None]
    has_names = [_MODEL in str(path) for path in written]
    if not any(has_names) and not any(path.is_dir() for path in options.meshes):
        return [replace(options, meshes=tuple(models), output=output)]
    if len(models) > 1 and not all(has_names):
        name = written[has_names.index(False)].name
        raise ValueError(f"output: expected a folder, or a name with %s for the name of each model, got {name!r}")
    stems = [model.stem for model in models]
    if twice := next((stem for stem in stems if stems.count(stem) > 1), None):
        raise ValueError(f"MESH: expected models with different names, got two that are called {twice}")

    def named(model: Path) -> Callable[[Path], Path]:
        return lambda path: Path(str(path).replace(_MODEL, model.stem))

    return [
        replace(
            options,
            meshes=(model,),
            output=None if output is None else named(model)(output),
            save=tuple((kind, named(model)(path)) for kind, path in options.save),
        )
        for model in models
    ]


def _has_views(options: RenderOptions) -> bool:
    """Return whether a model gets several pictures in a folder: a turntable, or all cameras of a file."""
    if options.camera is None or options.frame:
        return options.turntable is not None
    return len(load_cameras(options.camera, image_size("size", options.size or 1))[1]) > 1


def numbered(path: Path, number: int) -> Path:
    """Put the number of a view, from 0, into a name."""
    return path.with_name(NUMBER.sub(lambda found: format(number, f"{found[1]}d"), path.name))


def _models(path: Path) -> list[Path]:
    """List the mesh files of a folder, by their names; a file is one itself."""
    if not path.is_dir():
        return [path]
    found = sorted(file for file in path.iterdir() if file.suffix.lower() in MESH_SUFFIXES)
    if not found:
        raise ValueError(f"{path}: expected a folder with mesh files, got none that ends in {', '.join(MESH_SUFFIXES)}")
    return found
