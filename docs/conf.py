"""Sphinx's settings for the site: `make docs` builds it."""

import sys
from importlib.metadata import metadata
from pathlib import Path

import neural_renderer

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

project = "neural_renderer"
author = "The neural-renderer developers"
project_copyright = author
version = release = neural_renderer.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "command_help",
    "module_map",
    "public_names",
    "short_names",
    "shown_defaults",
]
exclude_patterns = ["_*", "README.md"]

# Pages in Markdown; those with code cells are executed, and executed again only when their cells change.
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
nb_execution_mode = "cache"
nb_execution_cache_path = str(Path(__file__).parents[1] / "out" / "docs" / "cache")
nb_execution_raise_on_error = True
nb_execution_timeout = 600
nb_execution_show_tb = True
nb_merge_streams = True
nb_render_image_options = {"alt": "output of the code above"}

# The reference, from docstrings.
default_role = "py:obj"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_typehints = "signature"
autodoc_type_aliases = {name: name for name in ("Array", "Scalar")}
napoleon_numpy_docstring = False
napoleon_use_ivar = True
python_maximum_signature_line_length = 90
add_module_names = False
nitpicky = True
nitpick_ignore_regex = [("py:class", ".*"), ("py:obj", r"typing\..*")]  # types of arguments, most of them of torch

# The repository's public address stands in pyproject.toml alone; without it pages have no links to their source.
urls = dict(url.split(", ", 1) for url in metadata("neural-renderer").get_all("Project-URL", []))

html_theme = "furo"
html_title = f"neural_renderer {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_copyright = False
html_show_sphinx = False
html_copy_source = False
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#2f5f9e", "color-brand-content": "#2f5f9e"},
    "dark_css_variables": {"color-brand-primary": "#8db8ec", "color-brand-content": "#8db8ec"},
    "source_repository": urls.get("Repository", ""),
    "source_branch": "main",
    "source_directory": "docs/",
}
