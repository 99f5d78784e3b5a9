"""The page on PyPI: the README, with relative links and pictures made absolute.

Everything else is in pyproject.toml. The repository's public address stands there alone, as ``Repository`` in
``[project.urls]``. Without it, relative links become plain text and pictures are left out, so that no link on the
page is broken.
"""

import re
from pathlib import Path

from setuptools import setup

ROOT = Path(__file__).parent
RELATIVE = r"\((?!https?://|#)([^)\s]+)\)"


def public_address() -> str:
    """Read the repository's public address from pyproject.toml; empty if there is none."""
    settings = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    found = re.search(r'^Repository = "(.*)"', settings, re.MULTILINE)
    return found.group(1).rstrip("/") if found else ""


def readme_for_pypi(text: str, address: str) -> str:
    """Make relative links and pictures absolute, or leave them out if the address is empty."""
    if not address:
        text = re.sub(rf"!\[[^\]]*\]{RELATIVE}\n*", "", text)
        return re.sub(rf"\[([^\]]*)\]{RELATIVE}", r"\1", text)
    text = re.sub(rf"(!\[[^\]]*\]){RELATIVE}", rf"\1({address}/raw/main/\2)", text)
    return re.sub(rf"(\[[^\]]*\]){RELATIVE}", rf"\1({address}/blob/main/\2)", text)


setup(
    long_description=readme_for_pypi((ROOT / "README.md").read_text(encoding="utf-8"), public_address()),
    long_description_content_type="text/markdown",
)
