"""Sphinx settings. Build: ``python -m sphinx -W --keep-going docs build/docs`` (extra ``labdaemon[docs]``)."""

from __future__ import annotations

from importlib.metadata import version as installed_version

project = "labdaemon"
author = "The labdaemon developers"
copyright = "the labdaemon developers"
release = version = installed_version("labdaemon")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.doctest",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx_click",
    "sphinx-mathjax-offline",  # MathJax comes with the pages: they must be readable in a laboratory without network
    "matplotlib.sphinxext.plot_directive",
]
myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence", "attrs_inline"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]

# autodoc: signatures show the annotations, the text shows shapes and units.
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
napoleon_google_docstring = False
napoleon_use_rtype = False

# Figures are drawn while the pages are built; no image file lies in the repository.
plot_include_source = False
plot_html_show_source_link = False
plot_html_show_formats = False
plot_formats = [("svg", 90)]

html_theme = "alabaster"
html_theme_options = {
    "description": "Vibration measured from motion blur",
    "fixed_sidebar": True,
    "page_width": "1080px",
    "sidebar_width": "240px",
}
html_show_sourcelink = False
doctest_global_setup = "import numpy as np"
