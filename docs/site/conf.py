"""How Sphinx makes the pages of docs/ into a site. `make docs` gathers the pages first (gather.py) and then calls it."""

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
html_math_renderer = "mathml"  # what browsers show themselves: the pages of the site fetch nothing from elsewhere
myst_heading_anchors = 4  # links to the headings of a page, as on the sites that show Markdown
nitpicky = True
nitpick_ignore_regex = [("py:.*", ".*")]  # types in docstrings, most of which are numpy's and have no page here
napoleon_google_docstring = False
autodoc_typehints = "none"  # docstrings name types, shapes and units
autodoc_member_order = "bysource"
smartquotes = False  # a pair of hyphens begins an option

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
    """Write a displayed equation as MathML, which scrolls where the page is narrower."""
    translator.body.append(f'<div style="overflow-x: auto">{tex2mathml(node.astext(), as_block=True)}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Register the renderer of equations."""
    app.add_html_math_renderer("mathml", (_inline_math, None), (_math_block, None))
