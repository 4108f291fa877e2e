"""Settings of Sphinx for the site; `scripts/docs` builds it."""

import sys
from importlib.metadata import version as version_of
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # generated_reference

project = "funnel-hil"
author = "the funnel-hil authors"
copyright = author  # noqa: A001 (Sphinx's name)
version = release = version_of("funnel-hil")

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "generated_reference",
]
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath", "attrs_inline"]
myst_heading_anchors = 3
nb_execution_mode = "off"  # tests/deploy/api executes the notebook; scripts/docs turns this on
nb_execution_raise_on_error = True
nb_execution_timeout = 120
exclude_patterns = ["_build"]
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
napoleon_use_ivar = True

html_math_renderer = "mathml"  # of generated_reference
smartquotes = False  # "--out" stays as it is

html_theme = "furo"
html_title = "funnel-hil"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False
html_theme_options = {"navigation_with_keys": True}
