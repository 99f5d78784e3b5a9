"""The direction of imports: data flows one way, and no module imports from a room above its own."""

from __future__ import annotations

import ast
import functools
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path
from types import ModuleType

import neural_renderer

SOURCE = Path(neural_renderer.__file__).parent

# From the bottom to the top; a module may import from its own room and from those before it.
ROOMS = [
    "version",
    "validate",
    "one_line",
    "movable",
    "constants",
    "metrics",
    "io",
    "raster",
    "comparators",
    "textures",
    "camera",
    "rotations",
    "meshes",
    "rigs",
    "deferred",
    "shading",
    "transparency",
    "losses",
    "optim",
    "surface_images",
    "strips",
    "rendering",
    "compat",
    "nvdiffrast",
    "features",
    "pictures",
    "many",
    "data",
    "tasks",
    "viewer",
    "commands",
    "cli",
    "__main__",
    "interface",
]

RASTER = [
    "warp",
    "ops",
    "colors",
    "clip",
    "visibility",
    "reference",
    "settings",
    "ahead",
    "outputs",
    "faces",
    "background",
    "depth_limits",
    "visible",
    "exact",
    "cube_colors",
    "rasterize",
]
RECONSTRUCTION = ["data", "shapes", "networks", "evaluation", "training"]


@functools.cache
def imports(path: Path) -> set[tuple[str, ...]]:
    """Collect the paths of the modules that a file imports, those for type checkers, too."""
    # Imports by string are not seen. One of them runs upwards: `compat/old_modules.py` loads members of old modules at
    # their first use, from `interface`.
    package, found = path.relative_to(SOURCE).parent.parts, set()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = package[: len(package) - node.level + 1] + tuple(
                (node.module or "").split(".") if node.module else ()
            )
            for name in node.names:
                inner = SOURCE.joinpath(*base, name.name)
                is_module = inner.is_dir() or inner.with_suffix(".py").is_file()
                found.add((*base, name.name) if is_module else base)
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            names = [name.name for name in node.names] if isinstance(node, ast.Import) else [node.module or ""]
            assert not any(name.partition(".")[0] == "neural_renderer" for name in names), (
                f"{path}: expected relative imports in the package"
            )
    return found


def room(parts: tuple[str, ...], prefix: tuple[str, ...]) -> str | None:
    """Find the room of a module below ``prefix``; None for the package itself and for other modules."""
    return parts[len(prefix)] if parts[: len(prefix)] == prefix and len(parts) > len(prefix) else None


def modules() -> Iterator[tuple[tuple[str, ...], Path]]:
    for path in sorted(SOURCE.rglob("*.py")):
        parts = path.relative_to(SOURCE).with_suffix("").parts
        yield parts[:-1] if parts[-1] == "__init__" else parts, path


def test_no_import_runs_upwards() -> None:
    layers = [((), ROOMS), (("raster",), RASTER), (("tasks", "reconstruction"), RECONSTRUCTION)]
    wrong = []
    for prefix, order in layers:
        for parts, path in modules():
            own = room(parts, prefix)
            if own is None:
                continue
            assert own in order, f"{path}: expected one of the rooms {', '.join(order)}; add {own} where it belongs"
            for target in imports(path):
                other = room(target, prefix)
                if other is not None and order.index(other) > order.index(own):
                    wrong.append(f"{path.relative_to(SOURCE)} imports {'.'.join(target)}")
    assert not wrong, "\n".join(wrong)


def test_no_circles() -> None:
    graph = {parts: {target for target in imports(path) if target != parts} for parts, path in modules() if parts}
    list(TopologicalSorter(graph).static_order())  # raises CycleError


def test_rooms_are_small() -> None:
    for folder in (path for path in SOURCE.rglob("*") if path.is_dir() and path.name != "__pycache__"):
        files = [path for path in folder.glob("*.py") if path.name != "__init__.py"]
        assert len(files) <= 14, f"{folder}: expected at most about a dozen files, got {len(files)}"


def test_public_names_are_there_on_demand() -> None:
    """A module of the same name would take the place of a public function as soon as anybody imports it."""
    files = {parts for parts, _ in modules()}
    for name in neural_renderer.__all__:
        value = getattr(neural_renderer, name)
        assert isinstance(value, ModuleType) or (name,) not in files, f"{name} is a module and a function"
    listed = dir(neural_renderer)
    assert set(neural_renderer.__all__) == {name for name in listed if not name.startswith("__")} | {"__version__"}
    assert len(set(listed)) == len(listed)
