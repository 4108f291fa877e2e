"""Settings of Sphinx for the site; `scripts/docs` builds it."""

from importlib.metadata import version as version_of
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx

project = "funnel-hil"
author = "the funnel-hil authors"
copyright = author  # noqa: A001 (Sphinx's name)
version = release = version_of("funnel-hil")

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
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

html_math_renderer = "mathml"  # of `setup`
smartquotes = False  # "--out" stays as it is

html_theme = "furo"
html_title = "funnel-hil"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False
html_theme_options = {"navigation_with_keys": True}


def _write_math(writer: Any, node: nodes.math | nodes.math_block) -> None:
    """Formulas as MathML: browsers show it without scripts, and offline."""
    is_block = isinstance(node, nodes.math_block)
    writer.body.append(tex2mathml(node.astext(), as_block=is_block))
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.add_html_math_renderer("mathml", (_write_math, None), (_write_math, None))
