"""The documentation site: `sphinx-build -W docs docs/_build`, without a network.

Links to the documentation of other packages need one, and are made where Read the Docs builds.
"""

import os
import sys
from pathlib import Path

DOCS = Path(__file__).parent
ROOT = DOCS.parent
sys.path[:0] = [str(ROOT), str(DOCS), str(DOCS / "_extensions")]

import drawings  # noqa: E402
import gallery  # noqa: E402

import jaxstab  # noqa: E402

drawings.draw(DOCS / "_drawings")
gallery.collect(ROOT / "notebooks", DOCS / "_notebooks")

project = "jaxstab"
author = "The jaxstab developers"
copyright = author
version = release = jaxstab.__version__

extensions = ["myst_nb", "sphinx_copybutton", "sphinx_design", "api", "mathml"]
if "READTHEDOCS" in os.environ:
    extensions.append("sphinx.ext.intersphinx")
intersphinx_mapping = {
    "python": ("https://docs.python.org/3", None),
    "numpy": ("https://numpy.org/doc/stable", None),
    "jax": ("https://docs.jax.dev/en/latest", None),
    "equinox": ("https://docs.kidger.site/equinox", None),
    "xarray": ("https://docs.xarray.dev/en/stable", None),
    "matplotlib": ("https://matplotlib.org/stable", None),
}
exclude_patterns = ["_build", "_notebooks/cards.md"]
# Notebooks show the outputs that they are stored with.
nb_execution_mode = "off"
nb_merge_streams = True
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath", "fieldlist"]
myst_heading_anchors = 3
# Dashes only: apostrophes in formulae are derivatives.
smartquotes_action = "D"
python_maximum_signature_line_length = 88
toc_object_entries_show_parents = "hide"

html_theme = "pydata_sphinx_theme"
html_math_renderer = "mathml"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_title = f"jaxstab {release}"
# Pages without a section of their own need no list of its pages.
html_sidebars = {page: [] for page in ("index",)}
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "navigation_with_keys": False,
    "show_prev_next": True,
    "header_links_before_dropdown": 8,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
}
