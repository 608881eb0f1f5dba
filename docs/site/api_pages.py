"""Generate the reference page of the Python API. Sphinx inserts the docstrings."""

from markup import page

import l3cli

GROUPS = {
    "Stages": ("calibrate", "simulate", "train", "render", "evaluate"),
    "Artifacts": ("load", "load_camera", "load_table", "load_training_set", "save"),
    "Raw frames": ("read_raw", "raw_frame"),
    "Rendering": ("Renderer", "region"),
    "Metrics": ("delta_e_2000", "scielab", "psnr", "ssim"),
    "Errors": ("L3Error",),
}
INTRO = (
    "This page is for looking up functions. It lists every function and class of `l3cli`, with its parameters, returned "
    "values and examples. The introduction is on the page [Python API](../python.md)."
)


def api_pages() -> dict[str, str]:
    """Return the page by its file name. Raise ValueError unless GROUPS contains every public name of the API."""
    named = sorted(name for names in GROUPS.values() for name in names)
    if named != sorted(l3cli.__all__):
        raise ValueError(f"docs/site/api_pages.py names {named}, not l3cli.__all__")
    sections = (page(f"## {title}", *map(directive, names)) for title, names in GROUPS.items())
    return {"python.md": page("# Python reference", INTRO, *sections)}


def directive(name: str) -> str:
    """Return the Sphinx directive that inserts the docstring of `name`."""
    members = "\n   :members:" if name == "Renderer" else ""
    kind = "autoclass" if isinstance(getattr(l3cli, name), type) else "autofunction"
    if name == "L3Error":
        kind = "autoexception"
    return f"```{{eval-rst}}\n.. {kind}:: l3cli.{name}{members}\n```"
