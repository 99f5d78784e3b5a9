"""What Python reads from the headers: constants."""

from __future__ import annotations

import math

import pytest

from neural_renderer.raster.warp.native import constant


@pytest.mark.parametrize(
    ("header", "name", "value"),
    [
        ("nmr.h", "PADDING", 16),
        ("nmr.h", "LINE_LANES", 8),  # the second of a line
        ("voxels.h", "OUTSIDE", 2),
        ("draw.h", "NO_FACE", 2**63 - 1),
        ("edge_hashes.h", "BACK", 0x5851F42D4C957F2D),
        ("pinhole.h", "LEAST_DEPTH", 1e-6),
        ("flat_light.h", "LARGEST_COORDINATE", 1e4),
        ("geometry.h", "NARROWEST", 2.0**-22),
    ],
)
def test_constant(header: str, name: str, value: float) -> None:
    found = constant(header, name, type(value))
    assert type(found) is type(value) and math.isclose(found, value, rel_tol=0, abs_tol=0)


@pytest.mark.parametrize(("name", "kind"), [("MISSING", int), ("PADDING", float), ("TINY", int)])
def test_a_constant_that_is_missing_or_of_another_kind(name: str, kind: type) -> None:
    with pytest.raises(ValueError, match=rf"nmr.h: expected a constexpr {name} of kind {kind.__name__}"):
        constant("nmr.h", name, kind)
