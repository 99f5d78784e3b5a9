"""Where the files are that tests need."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"
TEAPOT = EXAMPLES / "data" / "teapot.obj"
DATA = ROOT / "tests" / "data"
GOLDEN = ROOT / "tests" / "golden"
