"""Sphinx configuration of the site. `make docs` collects the pages (gather.py) and then runs Sphinx."""

from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from gather import DEMO
from sphinx.application import Sphinx

from l3cli import __version__

project = "l3cli"
author = "the l3cli authors"
release = version = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "markdown"}
root_doc = "index"

myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]
html_math_renderer = "mathml"  # browsers display MathML themselves, so pages fetch no scripts from other sites
myst_heading_anchors = 4  # anchors of headings have the same names as on GitHub
nitpicky = True
nitpick_ignore_regex = [("py:.*", ".*")]  # types in docstrings, most of which belong to numpy and have no page on this site
napoleon_google_docstring = False
autodoc_typehints = "none"  # the docstrings contain types, shapes and units
autodoc_member_order = "bysource"
smartquotes = False  # keep the double hyphens of options

html_theme = "furo"
html_title = f"l3cli {release}"
html_static_path = ["static"]
html_css_files = ["style.css"]
html_extra_path = [str(path) for name in ("demo.html", "demo.dng") if (path := DEMO / name).is_file()]
html_copy_source = html_show_sourcelink = False
html_show_sphinx = html_show_copyright = False


def _inline_math(translator: Any, node: nodes.math) -> None:
    """Write an inline equation as MathML."""
    translator.body.append(tex2mathml(node.astext(), as_block=False))
    raise nodes.SkipNode


def _math_block(translator: Any, node: nodes.math_block) -> None:
    """Write a displayed equation as MathML, which scrolls if it is wider than the page."""
    translator.body.append(f'<div style="overflow-x: auto">{tex2mathml(node.astext(), as_block=True)}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Register the functions that write equations."""
    app.add_html_math_renderer("mathml", (_inline_math, None), (_math_block, None))
