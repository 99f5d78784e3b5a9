"""Extras of the package: the optional libraries that each of them installs."""

from __future__ import annotations

from importlib.util import find_spec

# As in pyproject.toml, which adds versions.
EXTRAS = {
    "fit": ("pycolmap", "xatlas", "pillow_heif"),
    "finish": ("fast_simplification", "opengl_decimate", "xatlas"),
    "view": ("viser",),
    "reconstruct": ("lightning", "manifold3d", "tensorboard"),
    "cluster": ("ray", "pyarrow"),
    "edit": ("safetensors",),
    "exr": ("OpenEXR",),
    "compressed": ("DracoPy", "meshopt", "opengl_basisu"),
}


def advice(library: str) -> str:
    """Return the command that installs an optional library.

    It names the extra. pip reads extras from the package that is installed, so it asks no index for the package.
    """
    extra = next((name for name, libraries in EXTRAS.items() if library in libraries), None)
    return f'pip install "neural-renderer[{extra}]"' if extra else f"pip install {library}"


def missing(extra: str) -> list[str]:
    """List the libraries of an extra that are not installed, without importing them."""
    return [library for library in EXTRAS[extra] if find_spec(library) is None]
