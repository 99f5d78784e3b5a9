"""`neural-renderer batch`: many runs of `fit`, `style`, `dream` or `finish`, one for each row of a table."""

from __future__ import annotations

import json
from contextlib import closing

from ....io.atomic_write import write_file
from ...common.command import INTERRUPTED, say
from ..engines import Done, choose_engine
from ..options import BatchOptions
from ..progress import Watching
from .jobs import DoJob, read_entry, read_jobs
from .results import SHEET, TABLE, write_sheet, write_table


def run(options: BatchOptions) -> int:
    """Do the jobs of a table; return the exit code: 0, 1 if all jobs failed, or 130 after Ctrl-C."""
    engine, (part, count) = choose_engine(options.engine), options.engine.part()
    jobs = read_jobs(options.table, options.command)
    folder = options.output.resolve()
    share = jobs[part::count]
    missing = [job for job in share if read_entry(folder, job) is None]
    is_whole = True
    with Watching(len(share), "jobs") as watching:
        watching("before", Done(len(share) - len(missing)))
        try:
            with closing(engine.run(DoJob(folder, options.command), missing, watching)) as finished:
                for _ in finished:
                    pass
        except KeyboardInterrupt:
            is_whole = False
    if not is_whole:
        say(f"interrupted; the same command continues in {options.output}", "yellow")
        return INTERRUPTED
    failures = write_table(folder, jobs)
    entries = [entry for job in jobs if (entry := read_entry(folder, job)) is not None and entry["problem"]]
    write_file(folder / "failed.jsonl", "".join(f"{json.dumps(entry)}\n" for entry in entries))
    drawn = f" and {SHEET}" if write_sheet(folder, jobs) else ""
    watching.say_rates()
    if failures:
        say(f"{failures} of {len(jobs)} jobs failed; {options.output / 'failed.jsonl'} gives the reasons", "red")
    say(f"{TABLE}{drawn} are in {options.output}" if drawn else f"{TABLE} is in {options.output}")
    return int(failures == len(jobs))
