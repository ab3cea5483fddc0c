"""The documentation site. ``make docs`` builds it as a host would: ``python -m sphinx -W docs build/docs/html``."""

from __future__ import annotations

import os
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path[:0] = [str(HERE), str(ROOT)]
os.environ.setdefault("OMP_NUM_THREADS", "1")

from website import gallery, links, search  # noqa: E402

import flexhinf  # noqa: E402

# The project ----------------------------------------------------------------------------------------
project = "flexhinf"
author = "The flexhinf developers"
project_copyright = author
version = release = flexhinf.__version__

# Sources --------------------------------------------------------------------------------------------
extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "myst_nb",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "website.formulas",
    "website.links",
    "website.references",
    "website.api",
    "website.live",
    "website.drawings",
]
exclude_patterns = [
    "package.md",
    "website",
    "gallery/**/*.ipynb",
    "gallery/**/*.py",
    "gallery/backreferences",
    "**/GALLERY_HEADER.rst",
]
flexhinf_keys = links.keys_of(HERE / "references.bib")
nitpicky = True
default_role = "py:plain"
python_maximum_signature_line_length = 80
python_use_unqualified_type_names = True
autodoc_typehints = "signature"
toc_object_entries_show_parents = "hide"
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False
sphinx_gallery_conf = gallery.settings(ROOT / "build" / "docs" / "examples")

# MyST and notebooks ---------------------------------------------------------------------------------
myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence", "deflist", "attrs_inline"]
myst_heading_anchors = 4
nb_execution_mode = "cache"
nb_execution_in_temp = True
nb_execution_cache_path = str(ROOT / "build" / "docs" / "notebooks")
nb_execution_timeout = 240
nb_execution_raise_on_error = True
nb_execution_show_tb = True

# HTML -----------------------------------------------------------------------------------------------
html_theme = "pydata_sphinx_theme"
html_title = "flexhinf"
html_static_path = ["_static"]
html_favicon = "_static/favicon.svg"
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_math_renderer = "mathml"
html_show_sourcelink = False
html_copy_source = False
html_search_scorer = search.write(ROOT / "build" / "docs" / "scorer.js")
# Pages of the menu without pages below them have no list of these.
html_sidebars = {page: [] for page in ("index", "start/index", "choosing", "live", "compared/index", "faq")}
html_context = {"default_mode": "auto"}  # light or dark, as the reader's system is
html_theme_options = {
    "logo": {"text": f"flexhinf {version}"},
    "navigation_with_keys": False,
    "show_toc_level": 2,
    "header_links_before_dropdown": 7,
    "navbar_align": "left",
    "footer_start": ["copyright"],
    "footer_end": [],
    "show_prev_next": True,
    "secondary_sidebar_items": {"**": ["page-toc"], "index": []},
}

# External addresses are checked by `make docs-links` only: a build needs no network.
linkcheck_timeout = 20
linkcheck_anchors = False
