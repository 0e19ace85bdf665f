"""How Sphinx builds the site: `python3 dev.py docs`.  Nothing is fetched, at build or when a page is read."""

from __future__ import annotations

import sys
from importlib.metadata import version as version_of
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))

project = "dashpot"
author = "dashpot developers"
project_copyright = author
version = release = version_of("dashpot")

extensions = [
    "sphinx.ext.autodoc",
    "myst_nb",
    "mathml",  # the rest are modules of _ext
    "docstrings",
    "generated",
]
exclude_patterns = ["_build", "_ext", "_generated", "images/README.md"]
source_suffix = {".md": "myst-nb"}

# Everything that the pages need stands beside them: furo uses the fonts of the reader's system, formulas are MathML.
html_theme = "furo"
html_title = "dashpot"
html_static_path = ["_static"]
html_css_files = ["dashpot.css"]
html_show_sphinx = False
html_copy_source = False
html_show_sourcelink = False
html_use_opensearch = ""
html_math_renderer = "mathml"
nb_ipywidgets_js: dict[str, dict[str, str]] = {}
pygments_style = "a11y-high-contrast-light"
pygments_dark_style = "a11y-high-contrast-dark"
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#0b5394", "color-brand-content": "#0b5394"},
    "dark_css_variables": {"color-brand-primary": "#8ec5ff", "color-brand-content": "#8ec5ff"},
}

myst_enable_extensions = ["attrs_block", "colon_fence", "deflist", "dollarmath", "html_image"]
myst_heading_anchors = 4
myst_dmath_double_inline = True
myst_links_external_new_tab = False

# Cells are run at every build and must not fail.
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 120
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_class_signature = "mixed"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 72
highlight_language = "text"
smartquotes = False  # two hyphens begin an option
toc_object_entries_show_parents = "hide"
# Fragments that pages include begin below the title of the page; a page that a glob names may not be written yet.
suppress_warnings = ["myst.header", "toc.empty_glob"]
