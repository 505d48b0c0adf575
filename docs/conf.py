"""How Sphinx makes the site: `make docs`."""

import os
import re
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))
# For the kernels that run the tutorials: the checkout, one look for all figures, which are pictures in the page, one thread, no
# warnings of machine paths.
os.environ |= {
    "PYTHONPATH": str(ROOT),
    "MPLBACKEND": "module://matplotlib_inline.backend_inline",
    "MATPLOTLIBRC": str(Path(__file__).parent),
    "OMP_NUM_THREADS": "1",
    "PYTHONWARNINGS": "ignore",
}

import torchds  # noqa: E402

project = "torchds"
author = "the torchds authors"
version = release = torchds.__version__
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx-mathjax-offline",
]
exclude_patterns = ["_build", "**.ipynb_checkpoints"]
nitpicky = False

html_theme = "pydata_sphinx_theme"
html_title = f"torchds {version}"
html_static_path: list[str] = []
html_show_sourcelink = False
html_theme_options = {
    "show_prev_next": True,
    "navbar_end": ["theme-switcher"],
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
}
copyright = "the torchds authors, MIT licence"

myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence", "deflist"]
myst_heading_anchors = 3
suppress_warnings = ["myst.header"]  # pages that are read in the checkout begin where they like

nb_execution_mode = "cache"
nb_execution_in_temp = True
nb_output_stderr = "remove"
nb_execution_timeout = 120
nb_execution_raise_on_error = True
nb_render_image_options = {"align": "center"}
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
autodoc_type_aliases = {name: name for name in ("Array", "Closure", "StopCondition", "Reference")}
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 100
autodoc_default_options = {"members": True, "show-inheritance": True}
default_role = "code"  # single backticks are code in our docstrings
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False
napoleon_custom_sections = [("Shared options", "params_style")]
napoleon_use_ivar = True  # "Attributes:" describes fields, which autodoc lists once more otherwise


def leave_the_checkout_out(app: Any, name: str, source: list[str]) -> None:
    """Links that lead out of docs/ become the path of what they lead to: the site holds the pages alone."""
    depth = "../" * name.count("/")
    out = re.compile(r"\[([^\]]+)\]\(" + re.escape(depth) + r"\.\./([^)#]+)(?:#[^)]*)?\)")
    source[0] = out.sub(lambda link: f"{link[1]} (`{link[2]}`)", source[0])


def skip_fields(app: Any, what: str, name: str, obj: Any, skip: bool, options: Any) -> bool | None:
    """Fields of tuples stand under "Attributes:" of their class."""
    return True if (obj.__doc__ or "").startswith("Alias for field number") else None


def keep_norms(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """|x| outside of code is a norm: Sphinx would look for a substitution of that name."""
    for i, line in enumerate(lines):
        if not line.lstrip().startswith((">>>", "...", "..")):
            parts = line.split("`")
            parts[::2] = [part.replace("|", r"\|") for part in parts[::2]]
            lines[i] = "`".join(parts)


def setup(app: Any) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", keep_norms)
    app.connect("autodoc-skip-member", skip_fields)
    app.connect("source-read", leave_the_checkout_out)
