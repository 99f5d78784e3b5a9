"""Substitution of statements in C++ text."""

import re


def fill(code: str, **parts: str) -> str:
    """Replace the words that stand alone in C++ code by statements."""
    return re.sub(r"\b(" + "|".join(parts) + r")\b", lambda found: parts[found[0]], code)
