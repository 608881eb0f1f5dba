"""How Sphinx makes the pages of docs/ into a site. `make docs` gathers the pages first (gather.py) and then calls it."""

from gather import DEMO

from l3cli import __version__

project = "l3cli"
author = "the l3cli authors"
release = version = __version__
extensions = ["myst_parser"]
source_suffix = {".md": "markdown"}
root_doc = "index"

myst_heading_anchors = 4  # links to the headings of a page, as on the sites that show Markdown
nitpicky = True
smartquotes = False  # a pair of hyphens begins an option

html_theme = "furo"
html_title = f"l3cli {release}"
html_static_path = ["static"]
html_css_files = ["style.css"]
html_extra_path = [str(path) for name in ("demo.html", "demo.dng") if (path := DEMO / name).is_file()]
html_copy_source = html_show_sourcelink = False
html_show_sphinx = html_show_copyright = False
