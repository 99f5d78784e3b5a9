"""Each number that a module of `fit` or `pose` chose stands on a page, with its value and what it was measured by."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

import pytest

from tests.test_docs import ROOT

APPS, PAGE = ROOT / "src/neural_renderer/apps", ROOT / "docs/benchmarks/constants.md"
PLACES = ("fit", "pose", "common/masks", "common/views", "common/pictures/photograph.py")

NOT_MEASURED = {
    "common/masks/operations": "_OUTLINE _NEAR _LEAST_CONTRAST _SPECK",
    "common/masks/rule": (
        "_CLEAR _MOST_SEARCHED _BORDER _BACKGROUND_SHARE _SMOOTH _ITERATIONS _LEAST_RESIDUAL "
        "_LEAST_THRESHOLD _NOISES _MOST_THRESHOLD _MOST_OUTSIDE _BOX_SEARCHED _LEVELS _SOFT_FROM _SOFT_WIDTH"
    ),
    "common/pictures/photograph": (
        "FIRST_AZIMUTH LAMP _BACKDROP_TOP _BACKDROP_BOTTOM _AMBIENT _SKY _DIFFUSE _WRAP _GLOSS _SHININESS "
        "_SHADOW _SHADOW_STEEPNESS _SHADOW_BLUR _TOGETHER _MOST_PIXELS _SHADOW_FADE"
    ),
    "common/views/load": "_LEAST_SIZE _FINER _SHARE _COLORED _MOST_COLORED _LEAST_IMAGES _LEAST_POINTS _TAIL _LARGER",
    "common/views/maps": "_KNOWN _FLAT",
    "common/views/small_copies": "SIDE",
    "common/views/undistortion": "_LEAST_RADIUS",
    "common/views/up": "_UPRIGHT _SPREAD _SNAP",
    "common/views/views": "_VIEWS_AT_ONCE _INSIDE _REACH",
    "fit/agreement": (
        "REFINED_MARGIN _SIZE _RAYS _SAMPLES _PARTNERS _COMMON _WIDER _LEAST _FULL _BETTER _NAMED _SCALES"
    ),
    "fit/cameras": "_DECAY _FOCAL_RATE _PRIOR COARSE_RATE",
    "fit/commands/cameras": "_LEAST_LEFT _LEAST_OBJECT _FEW_POINTS",
    "fit/descent": "_MOMENTUM _SURFACE_DECAY LAST_RATE",
    "fit/detail/adaptive_descent": "_DECAYS _STEADY _GAIN _EVERY _BORDER _RELAX",
    "fit/detail/color_model": "_DECAY _EXACT _RIDGE",
    "fit/detail/consistency": "_NEAREST _WINDOW _NOISE _SHARED",
    "fit/detail/detail_fit": (
        "_LONGEST _DECAY_FROM _FLAT_FROM _COLOR_RATE _SETTLE _FLOOR _REACH _SMOOTHER _FINER _TRUST _SMOOTH_FROM"
    ),
    "fit/detail/pyramid": "_LEAST_SIZE _COARSE_SIZE _EDGE_PIXELS _FROM",
    "fit/detail/whole": "_STEPS",
    "fit/doubts": "ONE_SIDE SECOND _SMALL _COVERED _CUT _OFTEN _MATT _FEW _NOISE",
    "fit/exposure": "_CELLS _DARK _BRIGHT _ITERATIONS _EXACT _PRIOR _SPREAD _VIEWS_AT_ONCE",
    "fit/hull": "_HALF _COARSE _FINE _LEAST_COMPONENT LEVELS _LEAST_COVERED _LEAST_VIEWS _MOST_LEFT",
    "fit/mesh": "_REFINED_SCALE _REFINED_COLOR_FROM _SPHERE_RADIUS _WORSE _WORSE_FOUND _PACE _SPHERE_PACE",
    "fit/photos/beside": "_RIM _REACH _WINDOW _NOISES _LEAST _SPECK _HIDES _MOST_GAIN",
    "fit/photos/found": "_RIM _AROUND _WINDOW _MOST_ERROR _MOST_GAIN _DARK",
    "fit/photos/geometry/cut": "_NEIGHBOURS _REACH _TENSION _ROUNDS",
    "fit/photos/geometry/depth": "_PARTS _LEAST_POINTS _LEAST_SUPPORT",
    "fit/photos/geometry/solid": (
        "_PLANE_POINTS _VIEW_POINTS _SHOWN _SEARCH _BINS _LEAST_IN_BIN _NEAR _FLOATS _LOWEST _GAP "
        "_MOST_PIECES _LEAST_PIECE _SEEDS _MOST_OUTSIDE _MARGIN _CELLS _BAND _BEHIND _SURE _TENSION "
        "_LEAST_SHARE _STEPS _CUT_BINS _IN_BOX"
    ),
    "fit/photos/geometry/surface": "_LEVELS _SLOPE _LEAST_CLOUD _CELL _MOST_DEPTH _REACH _EDGE _PASSES",
    "fit/photos/histogram": "_BINS _NOTHING MOST",
    "fit/photos/masks/background": "_NEAR _FAR _USUAL _LEAST_POINTS _ALIKE _WINDOW _MOST _REACH _CELLS _BLUR _BAND",
    "fit/photos/masks/known_masks": (
        "_SIDE _LEAST_SHARE _LEAST_OBJECT _MOST_OBJECT _MOST_PATTERN _STEP _MOST_FAINT _SMALL _MOST_HOLES"
    ),
    "fit/photos/masks/mask_sheet": "_SIDE _COLUMNS _ROWS _OUTSIDE",
    "fit/photos/masks/object_masks": (
        "_SIDE _CELLS _ROUNDS _GROWTH _LEAST_CUT _WORST _FOOT _RIM _STANDS _RINGS _STILL _MOSTLY "
        "_LEAST_STILL _MOST_BORDER _MOST_CONTRADICTED _BAND"
    ),
    "fit/photos/masks/shape_masks": "_SIDE _LEAST_SEEN _LEAST_SCENE _POINTS _SOLID_CELL",
    "fit/photos/masks/surroundings": "_TRIED _LEAST _TOLERANCE _FLAT _TOGETHER",
    "fit/photos/missing": (
        "BLURRED SHARP _FEW_FEATURES _SAME _FEW_MATCHES _TURNS MOST_TURN _ONE_PLACE _ALIKE _ALIKE_SIDE"
    ),
    "fit/photos/motion": (
        "_FEATURE_SIDE _MOST_FEATURES _PEAK _LEAST_POSE _ERRORS _LEAST_ANGLE _MANY _SHARING _OUTSIDE"
    ),
    "fit/photos/pieces": "LEAST_MATCHES _TOLERANCE _AGREEMENT _SIDE",
    "fit/photos/witness": (
        "_NEAR _FAR _THROUGH _REACH _CELL _ABOVE _RIM _MOST_SAMPLES _OWN _LEAST_POINTS _LYING _FLAT _EDGE _ASIDE _FAINT"
    ),
    "fit/result": "LEAST_IOU",
    "fit/shape": "_COLOR_RATE _COLOR_SMOOTH _COARSE_CELLS _SMALLER _MISSED _COARSE_LAPLACIAN _COARSE_RATE",
    "fit/texture": "_OUTLINE",
    "fit/verdict": "_RIVALS",
    "pose/descent": (
        "_FIRST_DAMPING _LEAST_NOISE _LEAST_PRECISION _SCALE _DEEP _BLOCKS _LEFT_OUT _JOINED _SHORTEST "
        "_FARTHEST _LEAST_GAIN _PATIENCE"
    ),
    "pose/find": (
        "_SIZES _FACES _CANDIDATES _REFINED _COMPARED _SETTLING _SETTLED _BLOCK _LEAST_COLOR _ZOOMING "
        "_HOPELESS _NEIGHBORS _OTHER _MARGINS _AT_ONCE _LEAST_AGREEMENT _SURE _UNLIKE _MOST_RESIDUAL _LOST "
        "_ALIKE _INSIDE _LEAST_PIXELS _USUAL_ANGLE"
    ),
    "pose/model": "_NEAR _FAR _CELLS _MOST_ZOOM _LEAST_DEPTH _RIDGE",
    "pose/pictures": "_MOST_ROWS _FADED _GAP _GREY _EXCESS _LACK _OUTLINE",
    "pose/rig_command": "_AGREES",
    "pose/rig_fit": (
        "_LEVELS _COARSEST _ALIGNED _SURFACE _SAMPLES _REACH _TRIALS _REFINED _MOST_VERTICES _STEPS _NEAR"
    ),
    "pose/search": "_TEMPLATE _RADII _ANGLES _REACH _SETTLED _LIGHTS _RIDGE _AT_ONCE _SIDES _SIZES _SHIFTS",
    "pose/target": "_CLOSE _CLOSE_PRICE FAR_PRICE",
}  # names of constants that the page does not have yet; none may be added

pytestmark = pytest.mark.skipif(not PAGE.is_file(), reason="the documentation is not here")


def _is_number(node: ast.expr | None) -> bool:
    match node:
        case ast.Constant(value=bool()):
            return False
        case ast.Constant(value=int() | float()):
            return True
        case ast.UnaryOp(operand=operand):
            return _is_number(operand)
        case ast.BinOp(left=left, right=right):
            return _is_number(left) and _is_number(right)
        case ast.Tuple(elts=parts):
            return all(_is_number(part) for part in parts)
    return False


def constants() -> Iterator[tuple[str, str, str]]:
    """Yield folder, module and text, ``_NAME = value``, of each number, or numbers, with an upper-case name."""
    places = [APPS / place for place in PLACES]
    for file in sorted(file for place in places for file in (place.rglob("*.py") if place.is_dir() else [place])):
        source = file.read_text(encoding="utf-8")
        for statement in ast.parse(source).body:
            if isinstance(statement, ast.Assign | ast.AnnAssign) and _is_number(statement.value):
                target = statement.targets[0] if isinstance(statement, ast.Assign) else statement.target
                for name, value in _pairs(target, statement.value):
                    if ast.unparse(name).isupper():
                        text = f"{ast.unparse(name)} = {ast.get_source_segment(source, value)}"
                        yield file.parent.relative_to(APPS).as_posix(), file.stem, text


def _pairs(target: ast.expr, value: ast.expr | None) -> Iterator[tuple[ast.expr, ast.expr]]:
    """Yield each name of an assignment with its value."""
    if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
        yield from zip(target.elts, value.elts, strict=True)
    elif value is not None:
        yield target, value


def on_the_page() -> set[tuple[str, str, str]]:
    """Find constants of the page: ``## folder``, and in it ```module._NAME = value```."""
    found = set()
    for section in PAGE.read_text(encoding="utf-8").split("\n## ")[1:]:
        folder = section.partition("\n")[0].strip("` ")
        found |= {(folder, module, rest) for module, rest in re.findall(r"`(\w+)\.([A-Z_][^`\n]* = [^`\n]+)`", section)}
    return found


def test_every_constant_stands_on_the_page_with_its_value() -> None:
    waiting = {(path, name) for path, names in NOT_MEASURED.items() for name in names.split()}
    in_code = set(constants())
    missing = set()
    for folder, module, text in in_code - on_the_page():
        name = f"{folder}/{module}", text.partition(" = ")[0]
        if name not in waiting:
            missing.add(f"{folder}/{module}: {text}")
        waiting.discard(name)
    assert not missing, f"not on {PAGE.name}, or with another value"
    assert not on_the_page() - in_code, "only on the page"
    assert not waiting, "measured, or gone: no longer among those that are not"
