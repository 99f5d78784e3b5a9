"""`neural-renderer dataset`: views of many models, in shards or folders."""

from __future__ import annotations

from contextlib import closing
from dataclasses import fields
from pathlib import Path
from typing import Any

from ....camera.files.load import load_cameras
from ....raster.settings import image_size
from ....shading.environments.light import EnvironmentLight
from ...common.command import INTERRUPTED, say
from ..cameras import CameraPlan
from ..dataset import FAILED, DataSet
from ..engines import choose_engine, limits_of
from ..models import list_models
from ..options import DatasetOptions
from ..progress import Watching
from ..shards import MODELS
from ..views import ViewSettings, check_outputs
from ..workers import Worker, WorkerHere


def run(options: DatasetOptions) -> int:
    """Make a data set; return the exit code: 0, 1 if all models are left out, or 130 after Ctrl-C."""
    engine, share = choose_engine(options.engine), options.engine.part()
    settings = _settings(options)
    folder = options.output.resolve()
    for path in options.models:
        if path.resolve() == folder or (options.layout == "folders" and path.resolve().is_relative_to(folder / MODELS)):
            raise ValueError(f"--output: expected a folder without the models, got {options.output} for {path}")
    with closing(Worker(limits_of(options.engine)) if options.engine.processes else WorkerHere()) as worker:
        models = list_models(options.models, folder, worker)
    data = DataSet(folder, models, settings, options.layout, options.models_per_shard, options.index)
    data.describe()
    shards = data.shards()[share[0] :: share[1]]
    if share != (0, 1):
        say(f"part {share[0]} of {share[1]}: {len(shards)} of {len(data.shards())} shards")
    is_whole = True
    with Watching(sum(len(shard.models) for shard in shards)) as watching:
        try:
            data.make(engine, watching, share)
        except KeyboardInterrupt:
            is_whole = False
    if not is_whole:
        say(f"interrupted; the same command continues after the finished shards in {options.output}", "yellow")
        return INTERRUPTED
    is_complete = data.summarize()
    watching.say_rates()
    failed = (options.output / FAILED).read_text(encoding="utf-8").count("\n")
    if failed:
        say(f"{failed} of {len(models)} models are left out; {options.output / FAILED} gives the reasons", "red")
    rest = "" if is_complete else "; other parts are not finished, the last one writes the index"
    say(f"{watching.total.views} views in {watching.seconds:.0f} s; the data set is in {options.output}{rest}")
    return int(failed == len(models))


def _settings(options: DatasetOptions) -> ViewSettings:
    """Collect the settings of the views. The files that they name are read now, so that errors come first."""
    check_outputs(options.outputs)
    size = image_size("size", options.size)
    if options.environment is not None:
        EnvironmentLight.load(options.environment)
    kind, elevation = options.cameras, options.elevation or (20.0,)
    if kind == "sphere":
        elevation = options.elevation or (-90.0, 90.0)
    elif kind != "orbit":
        load_cameras(Path(kind), size)
        kind = str(Path(kind).resolve())
    same = {part.name: getattr(options, part.name) for part in fields(CameraPlan) if part.name != "kind"}
    cameras = CameraPlan(kind, **same | {"elevation": elevation})
    environment = None if options.environment is None else str(options.environment.resolve())
    given: dict[str, Any] = {part.name: getattr(options, part.name) for part in fields(ViewSettings)}
    return ViewSettings(**given | {"size": size, "cameras": cameras, "environment": environment})
