"""Many models: `neural-renderer dataset` under kills, its throughput beside Blender's, hostile files, memory.

python -m benchmarks.many_models cluster MODELS OUT     # a Ray cluster of three nodes on this machine, with losses
python -m benchmarks.many_models speed MODELS OUT       # models a second, one process and two
python -m benchmarks.many_models blender MODELS OUT     # the same views by Blender; BLENDER_PYTHON has its module bpy
python -m benchmarks.many_models hostile MODELS OUT     # 950 good models and 50 broken ones

MODELS is a folder of meshes. All but `blender` need the extra "cluster".
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

_KILLED = ("ray::part", "ray::_perform", "ray::IDLE")  # not Ray's agents, whose end is that of their node
_HERE = Path(__file__).parent
_VIEWS = ["--views", "12", "--size", "512", "--outputs", "rgba.png", "depth.png", "normal.png"]
_TINY = ["--views", "2", "--size", "64", "--outputs", "rgba.png", "depth.png"]


def command(*arguments: str | Path) -> list[str]:
    return [sys.executable, "-m", "neural_renderer.apps.command_line", "dataset", *map(str, arguments)]


def checksums(folder: Path) -> dict[str, str]:
    """SHA-256 of each file below a folder, also of hidden ones."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def digest(folder: Path) -> str:
    return hashlib.sha256(json.dumps(checksums(folder)).encode()).hexdigest()[:16]


def meshes(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.suffix in (".obj", ".glb", ".ply"))


def write_list(path: Path, models: list[Path], count: int) -> Path:
    """A list of ``count`` models; repeated ones have names of their own, and so other cameras."""
    rows = [f"{models[n % len(models)].resolve()},model_{n:05d}" for n in range(count)]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("path,name\n" + "\n".join(rows) + "\n")
    return path


def children(process: int) -> list[int]:
    """All processes below one."""
    found = [process]
    for parent in found:
        try:
            tasks = Path(f"/proc/{parent}/task").iterdir()
            found += [int(word) for task in tasks for word in (task / "children").read_text().split()]
        except OSError:
            continue
    return found[1:]


def cluster(models: Path, out: Path, count: int = 500) -> None:
    """Three nodes of one processor; ten workers and two drivers are killed, one node is removed and one added."""
    from ray.cluster_utils import Cluster

    table = write_list(out / "models.csv", meshes(models), count)
    options = [*_TINY, "--cameras", "sphere", "--models-per-shard", "5"]
    start = time.monotonic()
    subprocess.run(command(table, "-o", out / "undisturbed", *options, "-j", "2"), check=True)
    print(f"undisturbed, local: {time.monotonic() - start:.0f} s, {digest(out / 'undisturbed')}", flush=True)
    chance, target = random.Random(0), out / "disturbed"
    nodes = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    extra = [nodes.add_node(num_cpus=1), nodes.add_node(num_cpus=1)]
    ray = [*options, "--engine", "ray", "--address", nodes.address]
    total = len(range(0, count, 5))
    events = ["worker"] * 10 + ["driver", "driver", "remove", "add"]
    chance.shuffle(events)
    events.remove("add")
    events.insert(events.index("remove") + 1, "add")
    at = [int(total * (n + 1) / (len(events) + 2)) for n in range(len(events))]
    start = time.monotonic()
    driver = subprocess.Popen(command(table, "-o", target, *ray))
    while driver.poll() is None or driver.returncode != 0:
        if driver.poll() is not None:
            print(f"driver ended with {driver.returncode}; the same command again", flush=True)
            driver = subprocess.Popen(command(table, "-o", target, *ray))
        done = len(list((target / "manifest").glob("*.json"))) if target.exists() else 0
        if at and done >= at[0]:
            at.pop(0)
            event = events.pop(0)
            print(f"{time.monotonic() - start:5.0f} s, {done} of {total} shards: {event}", flush=True)
            if event == "driver":
                driver.kill()
                driver.wait()
            elif event == "remove":
                nodes.remove_node(extra.pop(0))
            elif event == "add":
                extra.append(nodes.add_node(num_cpus=1))
            else:
                names = ((process, _name(process)) for process in children(os.getpid()))
                workers = [process for process, name in names if name.startswith(_KILLED) or "spawn_main" in name]
                victim = chance.choice(workers)
                print(f"  killed: {_name(victim)[:40]}", flush=True)
                os.kill(victim, signal.SIGKILL)
        time.sleep(0.05)
    print(f"disturbed, Ray: {time.monotonic() - start:.0f} s, {digest(target)}; events left {events}", flush=True)
    nodes.shutdown()
    one, two = checksums(out / "undisturbed"), checksums(target)
    different = sorted(name for name in one.keys() | two.keys() if one.get(name) != two.get(name))
    print(f"{len(one)} files; different: {different or 'none'}")


def _name(process: int) -> str:
    try:
        return Path(f"/proc/{process}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
    except OSError:
        return ""


def speed(models: Path, out: Path, count: int = 60) -> None:
    """Processor time a view of one process and of two, in turns, as the workers measure it."""
    table = write_list(
        out / "models.csv", random.Random(0).sample(meshes(models), min(count, len(meshes(models)))), count
    )
    costs: dict[int, list[float]] = {1: [], 2: []}
    for _ in range(2):
        for processes in costs:
            target = out / f"speed_{processes}"
            shutil.rmtree(target, ignore_errors=True)
            done = subprocess.run(
                command(table, "-o", target, *_VIEWS, "-j", str(processes)), check=True, capture_output=True, text=True
            )
            line = next(line for line in done.stdout.splitlines() if "of processor time a view" in line)
            print(f"{processes}: {line}", flush=True)
            costs[processes].append(float(line.split()[0]))
    best = {processes: min(found) for processes, found in costs.items()}
    rate = 2 * 1000 / (12 * best[2])
    print(f"models/s of two idle processors {rate:.2f}, of 100 such machines {100 * rate:.0f}")
    print(f"efficiency of two processes {best[1] / best[2]:.3f}")


def blender(models: Path, out: Path, count: int = 8) -> None:
    """The views of `speed` by Blender: Cycles with one sample, Workbench, EEVEE, each with depth and normals."""
    table = write_list(out / "models.csv", random.Random(0).sample(meshes(models), count), count)
    program = str(_HERE / "many_models_blender.py")
    for engine in ("CYCLES", "BLENDER_WORKBENCH", "BLENDER_EEVEE"):
        start = time.monotonic()
        python = os.environ.get("BLENDER_PYTHON", sys.executable)
        try:
            done = subprocess.run(
                [python, program, str(table), str(out / engine), engine],
                timeout=300,
                check=False,
                capture_output=True,
                text=True,
            )
        except subprocess.TimeoutExpired:
            print(f"{engine}: more than 300 s")
            continue
        last = [line for line in done.stdout.splitlines() if line.startswith("models/s")]
        print(
            f"{engine}: {last[-1] if last else 'failed: ' + done.stderr[-300:]} ({time.monotonic() - start:.0f} s)",
            flush=True,
        )


def hostile(models: Path, out: Path, count: int = 1000) -> None:
    """950 good models, and 50 that are broken in ten ways; then the memory of the worker processes."""
    folder = out / "bad"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    box = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    for n in range(5):
        (folder / f"empty_{n}.obj").touch()
        (folder / f"nan_{n}.obj").write_text(box.replace("1 0 0", "nan 0 0"))
        with (folder / f"large_{n}.obj").open("wb") as file:
            file.truncate(2 << 30)
        with zipfile.ZipFile(folder / f"inner_{n}.zip", "w") as pack:
            pack.write(folder / f"inner_{n - 1}.zip" if n else __file__, "inner.zip")  # up to five in each other
        os.mkfifo(folder / f"pipe_{n}.obj")
        (folder / f"wrong_{n}.glb").write_text(box)
        (folder / f"lost_{n}.obj").write_text(f"mtllib lost_{n}.mtl\nusemtl x\n" + box)
        (folder / f"lost_{n}.mtl").write_text("newmtl x\nmap_Kd none.png\n")
        (folder / f"index_{n}.obj").write_text(box.replace("1 2 3", "1 2 9"))
        (folder / f"bytes_{n}.stl").write_bytes(random.Random(n).randbytes(5000))
    grid = 3163  # 3162² squares, of two faces each in the file of 10⁷ faces
    with (folder / "faces_0.obj").open("w") as file:
        file.writelines(f"v {i % grid} {i // grid} 0\n" for i in range(grid * 1600))
        rows = ((i, i + 1, i + grid + 1, i + grid) for i in range(1, grid * 1599) if i % grid)
        file.writelines(f"f {a} {b} {c}\nf {a} {c} {d}\n" for a, b, c, d in rows)
    for n in range(1, 5):
        (folder / f"faces_{n}.obj").symlink_to("faces_0.obj")
    good = meshes(models)
    rows = [f"{good[n % len(good)].resolve()},good_{n:05d}" for n in range(count - 50)]
    rows += [f"{path},{path.stem}" for path in sorted(folder.iterdir()) if path.suffix not in (".zip", ".mtl")]
    rows += [f"{path},{path.stem}" for path in sorted(folder.glob("*.zip"))]
    (out / "hostile.csv").write_text("path,name\n" + "\n".join(rows) + "\n")
    start, most, early, late = time.monotonic(), 0, [], []
    limits = ["--time-limit", "60", "--memory-limit", "2"]
    process = subprocess.Popen(command(out / "hostile.csv", "-o", out / "hostile", *_TINY, *limits, "-j", "2"))
    while process.poll() is None:
        sizes = [_resident(worker) for worker in children(process.pid) if "spawn_main" in _name(worker)]
        done = len(list((out / "hostile" / "manifest").glob("*.json")))
        most = max([most, *sizes])
        (early if done < 12 else late).extend(size for size in sizes if size > 2e8)
        time.sleep(0.2)
    failed = [json.loads(line) for line in (out / "hostile" / "failed.jsonl").read_text().splitlines()]
    bad = [row for row in failed if row["name"].startswith("good")]
    print(
        f"{time.monotonic() - start:.0f} s, {len(failed)} failed, of them good: {len(bad)}; "
        f"most memory {most / 2**30:.2f} GiB"
    )
    for kind in dict.fromkeys(row["name"].rpartition("_")[0].rpartition("/")[0] or row["name"][:5] for row in failed):
        row = next(row for row in failed if row["name"].startswith(kind))
        print(f"  {row['name']}: {row['problem'][:150]}")
    for name, sizes in (("first", early), ("last", late)):
        if sizes:
            print(f"median memory of a worker, {name} shards: {sorted(sizes)[len(sizes) // 2] / 2**20:.0f} MiB")


def _resident(process: int) -> int:
    try:
        return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError, ValueError):
        return 0


if __name__ == "__main__":
    if len(sys.argv) not in (4, 5) or sys.argv[1] not in ("cluster", "speed", "blender", "hostile"):
        sys.exit(__doc__)
    globals()[sys.argv[1]](Path(sys.argv[2]), Path(sys.argv[3]), *map(int, sys.argv[4:]))
