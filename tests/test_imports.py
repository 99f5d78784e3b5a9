"""The direction of imports: data flows one way, and no module imports from a room above its own."""

from __future__ import annotations

import ast
import functools
import gc
import re
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path
from types import ModuleType

import pytest

import neural_renderer
from neural_renderer import apps
from neural_renderer.apps.command_line import command_names, main
from neural_renderer.apps.commands import COMMANDS, Command
from tests.paths import ROOT

SOURCE = Path(neural_renderer.__file__).parent

# From the bottom to the top; a module may import from its own room and from those before it.
CORE = [
    "version",
    "base",
    "io",
    "raster",
    "textures",
    "camera",
    "meshes",
    "shading",
    "rendering",
    "optim",
    "compat",
    "interface",
]
ROOMS = [*CORE, "apps", "__main__"]

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
    "fragments",
    "cube_colors",
    "rasterize",
]

RECONSTRUCTION = ["settings", "options", "data", "shapes", "networks", "evaluation", "training", "commands"]


@functools.cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@functools.cache
def nodes_of(path: Path) -> list[ast.AST]:
    return list(ast.walk(tree(path)))


# Files that import modules whose names are computed, and what these are.
COMPUTED_IMPORTS = {
    "__init__.py": "public names, at their first use",
    "apps/command_line.py": "commands, by `apps/commands.py`",
    "apps/common/lazy.py": "public names of an application, at their first use",
    "apps/many/commands/jobs.py": "commands, by `apps/commands.py`",
    "apps/run/pytorch3d/stand_in.py": "its own modules, under names of PyTorch3D",
    "apps/run/stand_ins/finder.py": "its own modules, under names of others",
    "base/private.py": "modules of torch and Warp",
    "base/requirements.py": "libraries of extras",
    "compat/first_packages/old_modules.py": "members of old modules, from `interface`, at their first use",
    "compat/moved_modules.py": "modules under old names",
}
# `Camera.load` and `Camera.save` call the room's own readers and writers, which make cameras.
CIRCLE = {("camera", "camera"): ("camera", "files", "load")}


@functools.cache
def imports_by_string(path: Path) -> list[tuple[str, ...] | None]:
    """Find the modules that a file imports by strings; None stands for a computed name."""
    package, found = path.relative_to(SOURCE.parent).parent.parts, list[tuple[str, ...] | None]()
    known = {"__package__": ".".join(package), "__name__": ".".join((*package, path.stem))}
    for node in nodes_of(path):
        called = getattr(node.func, "id", getattr(node.func, "attr", "")) if isinstance(node, ast.Call) else ""
        if isinstance(node, ast.Call) and called in ("import_module", "__import__"):
            name = ast.unparse(node.args[0])
            for variable, value in known.items():
                name = name.replace(f"{{{variable}}}", value)
            text = re.fullmatch(r"f?(['\"])([\w.]+)\1", name)
            if text is None:
                found.append(None)
            elif text[2].startswith("neural_renderer."):
                found.append(tuple(text[2].split(".")[1:]))
    return found


def test_imports_by_string_are_known() -> None:
    """Others take part in the order of the rooms, as if they were written as imports."""
    computed = {path.relative_to(SOURCE).as_posix() for _, path in modules() if None in imports_by_string(path)}
    assert computed == set(COMPUTED_IMPORTS)


@functools.cache
def imports(path: Path) -> set[tuple[str, ...]]:
    """Collect the paths of the modules that a file imports, those for type checkers, too."""
    package, found = path.relative_to(SOURCE).parent.parts, set(imports_by_string(path)) - {None}
    for node in nodes_of(path):
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


@functools.cache
def applications() -> dict[str, set[str]]:
    """Find the applications, each with those that it is built on, which the first lines of its package name."""
    files = {path.parent.name: path for path in (SOURCE / "apps").glob("*/__init__.py")}
    said = {name: (ast.get_docstring(tree(path)) or "").partition("Built on ")[2] for name, path in files.items()}
    return {name: set(re.findall(r"`(\w+)`", text)) & set(files) for name, text in said.items()}


def room(parts: tuple[str, ...], prefix: tuple[str, ...]) -> str | None:
    """Find the room of a module below ``prefix``; None for the package itself and for other modules."""
    return parts[len(prefix)] if parts[: len(prefix)] == prefix and len(parts) > len(prefix) else None


def modules() -> Iterator[tuple[tuple[str, ...], Path]]:
    for path in sorted(SOURCE.rglob("*.py")):
        parts = path.relative_to(SOURCE).with_suffix("").parts
        yield parts[:-1] if parts[-1] == "__init__" else parts, path


def test_no_import_runs_upwards() -> None:
    layers = [((), ROOMS), (("raster",), RASTER), (("apps", "reconstruct"), RECONSTRUCTION)]
    wrong = []
    for prefix, order in layers:
        assert {*order} == {found for parts, _ in modules() if (found := room(parts, prefix))}, "rooms that exist"
        for parts, path in modules():
            own = room(parts, prefix)
            if own is None:
                continue
            for target in imports(path):
                other = room(target, prefix)
                if other is not None and order.index(other) > order.index(own):
                    wrong.append(f"{path.relative_to(SOURCE)} imports {'.'.join(target)}")
    assert not wrong, "\n".join(wrong)


def test_the_core_is_small() -> None:
    """It has few rooms, on few floors: a room is one floor above the highest that it imports."""
    below: dict[str, set[str]] = {name: set() for name in CORE}
    for parts, path in modules():
        if parts and parts[0] in CORE:
            below[parts[0]] |= {target[0] for target in imports(path) if target and target[0] in CORE} - {parts[0]}
    floors: dict[str, int] = {}
    for name in CORE:
        floors[name] = 1 + max((floors[other] for other in below[name]), default=0)
    assert len(CORE) <= 14
    assert max(floors.values()) <= 10, floors
    core = [path for path in SOURCE.rglob("*") if path.suffix in (".py", ".h") and "apps" not in path.parts]
    assert sum(path.read_bytes().count(b"\n") for path in core) <= 35_000


# Functions of more than twelve parameters, and why.
LONG_SIGNATURES = {
    "render": "the options of a picture, each named where it is used",
    "rasterize_images": "the options of `render` that need no camera, under the same names",
    "Renderer.__init__": "the first packages' signature",
    "UVMesh.__init__": "the attributes, which `replace` and files name one by one, and the form with one image",
}


def test_signatures_are_short() -> None:
    found = set()
    for _, path in modules():
        owners = {child: node.name for node in nodes_of(path) if isinstance(node, ast.ClassDef) for child in node.body}
        for node in nodes_of(path):
            if isinstance(node, ast.FunctionDef):
                given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
                if len([each for each in given if each.arg not in ("self", "cls")]) > 12:
                    found.add(f"{owners[node]}.{node.name}" if node in owners else node.name)
    assert found == set(LONG_SIGNATURES)


def test_messages_of_the_library_name_no_options() -> None:
    """They name arguments, such as allow_outside=True, which the command line writes as options."""
    found = []
    for parts, path in modules():
        if parts[-1:] and (parts[-1].endswith(("command", "options", "command_line")) or "commands" in parts):
            continue
        nodes = nodes_of(path)
        texts = {node.value for node in nodes if isinstance(node, ast.Expr)}  # docstrings
        texts = {node for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)} - texts
        found += [
            f"{path}:{node.lineno}: {node.value}" for node in texts if re.search("(^|[^<-])--([a-z]|$)", node.value)
        ]
    assert not found, "\n".join(found)


def defaults(node: ast.AST) -> Iterator[tuple[str, str]]:
    """List the names and literal defaults of a function's parameters or a class's fields, but for trivial ones."""
    pairs: list[tuple[ast.arg | ast.expr, ast.expr | None]] = []
    if isinstance(node, ast.FunctionDef):
        given = [*node.args.posonlyargs, *node.args.args]
        pairs += zip(reversed(given), reversed(node.args.defaults), strict=False)
        pairs += zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True)
    elif isinstance(node, ast.ClassDef):
        pairs += [(each.target, each.value) for each in node.body if isinstance(each, ast.AnnAssign)]
    for name, value in pairs:
        literals = {each.value for each in ast.walk(value or name) if isinstance(each, ast.Constant)}
        names = any(isinstance(each, ast.Name) for each in ast.walk(value)) if value else True
        if not names and literals - {None, True, False, ""}:  # 0 and 1 are False and True
            yield name.arg if isinstance(name, ast.arg) else ast.unparse(name), ast.unparse(value or name)


def test_defaults_of_options_stand_once() -> None:
    """A parameter of an application that is an option, too, takes its default from there or from a constant."""
    for name in applications():
        folder = SOURCE / "apps" / name
        own = folder / "options.py"
        known = {pair for node in nodes_of(own) for pair in defaults(node)} - {("device", "'auto'")}
        for path in folder.rglob("*.py"):
            found = {pair for node in nodes_of(path) for pair in defaults(node)} if path != own else set()
            assert not found & known, f"{path}: expected the defaults of {own}, got {found & known} again"


def test_no_name_is_newer_than_python_3_10() -> None:
    """The oldest Python of the package lacks these names of `typing`, which tests of that Python may not import."""
    newer = {"LiteralString", "Never", "NotRequired", "Required", "Self", "Unpack", "assert_never", "override"}
    for _, path in modules():
        for node in nodes_of(path):
            if isinstance(node, ast.ImportFrom) and node.module == "typing":
                assert not newer & {name.name for name in node.names}, f"{path}: expected names of Python 3.10"


def test_no_circles() -> None:
    graph = {parts: imports(path) - {parts, CIRCLE.get(parts)} for parts, path in modules() if parts}
    list(TopologicalSorter(graph).static_order())  # raises CycleError


def test_the_core_imports_no_application() -> None:
    """Nor does it load one by a string; `__init__` alone, which the user imports, names the public ones."""
    for parts, path in modules():
        if parts and parts[0] in CORE:
            assert not any(target[:1] == ("apps",) for target in imports(path)), f"{path} imports an application"
            names = re.findall(r"[\"'](?:neural_renderer\.)?apps\.[\w.]*", path.read_text(encoding="utf-8"))
            assert not names or path.name == "moved_modules.py", f"{path} names {', '.join(names)}"


def test_the_form_of_a_camera_is_known_in_its_room() -> None:
    """Whether rows of ``rotation`` point up or down, which depends on K; others ask for `Camera.axes`."""
    asking = set()
    for parts, path in modules():
        if parts[:1] != ("camera",) and re.search(r"camera\.K is (not )?None", path.read_text(encoding="utf-8")):
            asking.add("/".join(parts))
    assert asking == {"apps/fit/agreement"}  # which changes K itself


# What only applications use, and why it is in the core all the same.
FOR_APPLICATIONS = {
    "base/requirements.py": {"require_library"},  # beside `import_library`
    "camera/camera.py": {"with_extrinsics"},  # asks whether a camera has K
    "io/gltf/writer.py": {"glb_of_levels"},  # by the writer of a single mesh
    "io/image_formats/png.py": {"save_png_strips"},  # by the parts of `encode_png`
    "io/images.py": {"pictures_reduced", "size_of"},  # the first is for the readers of meshes
    "io/named_files.py": {"is_outside"},  # by the parts of `find_file`
    "raster/ops/voxels.py": {"distances", "fill"},  # kernels in C++
    "rendering/forward.py": {"render_rows", "render_strips"},  # by the parts of `render`
}
# Names for users: modules of the interface, and names of other packages.
FOR_USERS = ("compat", "camera/rotations.py", "optim/losses.py", "optim/metrics.py")


def test_the_core_uses_what_it_has() -> None:
    """A function or class that only applications use belongs to them."""
    core = [path for parts, path in modules() if parts and parts[0] in CORE]
    words: dict[Path, set[str]] = {}
    for path in core:
        nodes = nodes_of(path)
        words[path] = {node.id for node in nodes if isinstance(node, ast.Name)}
        words[path] |= {node.attr for node in nodes if isinstance(node, ast.Attribute)}
        words[path] |= {node.name for node in nodes if isinstance(node, ast.alias)}
    assert all((SOURCE / name).exists() for name in FOR_USERS)
    known = functools.reduce(set.union, words.values())
    found = {}
    for path in core:
        defined = {node.name for node in tree(path).body if isinstance(node, (ast.FunctionDef, ast.ClassDef))}
        name = path.relative_to(SOURCE).as_posix()
        if not name.startswith(FOR_USERS) and defined - known - {"_"}:
            found[name] = defined - known - {"_"}
    assert found == FOR_APPLICATIONS


def test_applications_are_built_on_those_that_they_say() -> None:
    """All are built on the core and on `common` besides, and none, by others, on itself."""
    used: dict[str, set[str]] = {name: set() for name in applications()}
    for parts, path in modules():
        if parts[:1] == ("apps",) and len(parts) > 1 and parts[1] in used:
            used[parts[1]] |= {target[1] for target in imports(path) if target[:1] == ("apps",) and len(target) > 1}
    common = {"common", *(path.stem for path in (SOURCE / "apps").glob("*.py"))}
    assert {name: others - {name} - common for name, others in used.items()} == applications()
    assert not used["common"] - common
    list(TopologicalSorter(applications()).static_order())  # raises CycleError


def test_a_new_application_is_a_folder_a_line_and_a_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its help is in the reference, and its page, a file in docs/tools, among those of the other commands."""
    folder = tmp_path / "toy"
    folder.mkdir()
    (folder / "__init__.py").write_text('"""Command `toy`."""\n')
    (folder / "options.py").write_text(
        "from dataclasses import dataclass\n\n\n@dataclass\nclass ToyOptions:\n"
        '    """Play."""\n\n    times: int = 1\n    """How often."""\n'
    )
    (folder / "command.py").write_text("def run(options):\n    return options.times\n")
    monkeypatch.setattr(apps, "__path__", [*apps.__path__, str(tmp_path)])
    monkeypatch.setitem(COMMANDS, "toy", Command("Play.", "toy.command"))
    assert main(["toy", "--times", "5"]) == 5
    assert gc.isenabled() and gc.get_freeze_count()  # collections leave out what the command has imported
    assert main(["toy", "--help"]) == 0
    assert "toy" in command_names()
    if (ROOT / "docs").is_dir():
        assert re.search(
            r"```\{toctree\}\n:hidden:\n:glob:\n[^`]*\n\*\n```", (ROOT / "docs/tools/index.md").read_text("utf-8")
        )


def test_rooms_are_small() -> None:
    for folder in (path for path in SOURCE.rglob("*") if path.is_dir() and path.name != "__pycache__"):
        files = [path for path in folder.glob("*.py") if path.name not in ("__init__.py", "interface.py", "options.py")]
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
