"""Tables of docs/ that are generated from registries. `python docs/site/format_tables.py` updates them in their pages.

A table is between the comments `<!-- NAME -->` and `<!-- end -->` of a page.
"""

import re
from collections.abc import Callable
from pathlib import Path

from markup import code, table

from l3cli.cli.terminal import with_options
from l3cli.frames.packings import BAYER_ORDERS, FAMILIES, PACKINGS
from l3cli.io.raw.files import FORMATS as RAW_FORMATS
from l3cli.io.raw.unread import UNREAD
from l3cli.io.scenes import FORMATS
from l3cli.io.scenes.envi import FIELDS, HARMLESS, READ, REFUSED

DOCS = Path(__file__).parents[1]


def packings() -> str:
    """Return the table of packings by family. Bayer names differ from Mono names only in their first letters.

    Names that only polarisation cameras use have separate rows.
    """
    orders = ", ".join(code(f"Bayer{order}") for order in BAYER_ORDERS)
    rows = []
    for family, meaning in FAMILIES.items():
        names = [
            name
            for name, packing in PACKINGS.items()
            if packing.family == family and not (packing.pattern or packing.polarised)
        ]
        bayer = any(packing.family == family and packing.pattern for packing in PACKINGS.values())
        rows.append([", ".join(map(code, names)) + (f"; {orders} in place of `Mono`" if bayer else ""), meaning])
    for cells, meaning in (
        (False, "raw frames of a polarisation camera; the bits are packed as in the `Mono` format with the same suffix"),
        (True, "raw frames of a polarisation camera, in which the four pixels of each 2×2 cell follow one another"),
    ):
        names = [name for name, packing in PACKINGS.items() if packing.polarised and packing.cells is cells]
        rows.append([", ".join(map(code, names)), meaning])
    return table(["`--packing`", "pixels"], rows)


def raw_formats() -> str:
    """Return the table of raw formats that l3 reads."""
    rows = ([each.what, " ".join(map(code, each.suffixes)), with_options(each.read_as)] for each in reversed(RAW_FORMATS))
    return table(["format", "suffixes", "what is read"], rows)


def unread_formats() -> str:
    """Return the table of formats that l3 recognises but cannot read."""
    rows = ([each.name, " ".join(map(code, each.suffixes)), each.instead] for each in UNREAD)
    return table(["file", "suffixes", "what to do"], rows)


def scenes() -> str:
    """Return the table of scene files, by the value of `source` in a recipe."""
    return table(["`source`", "file", "what it states"], ([code(each.source), each.holds, each.states] for each in FORMATS))


def envi_fields(fate: str) -> str:
    """Return the table of ENVI header fields with the given `fate`. Fields with the same meaning share a row."""
    rows: dict[str, list[str]] = {}
    for field in FIELDS:
        if field.fate == fate:
            rows.setdefault(field.meaning, []).append(code(field.name))
    return table(["field", "meaning"], ([", ".join(names), meaning] for meaning, names in rows.items()))


def decoders() -> str:
    """Return the list item with the raw formats that the isolated process decodes, and the formats that l3 reads itself."""
    names = {each: each.what.partition(" (extra")[0].partition(", also")[0] for each in RAW_FORMATS}
    isolated, own = (", ".join(names[each] for each in RAW_FORMATS if each.isolated is where) for where in (True, False))
    own += ", and TIFF files in the layout that l3 writes"
    return f"* **Raw files.** The isolated process decodes these formats: {isolated}. l3 itself reads these formats: {own}."


TABLES: dict[str, dict[str, Callable[[], str]]] = {
    "raw-files.md": {"raw-formats": raw_formats, "packings": packings, "formats-not-read": unread_formats},
    "../SECURITY.md": {"decoders": decoders},
    "spectral-scenes.md": {
        "scenes": scenes,
        "envi-read": lambda: envi_fields(READ),
        "envi-refused": lambda: envi_fields(REFUSED),
        "envi-harmless": lambda: envi_fields(HARMLESS),
    },
}


def with_tables(page: str, text: str) -> str:
    """Return the text of a page with its tables updated from the registries."""
    for name, made in TABLES[page].items():
        places = list(re.finditer(rf"(?<=<!-- {name} -->\n).*?(?=<!-- end -->)", text, re.DOTALL))
        if len(places) != 1:
            raise ValueError(f"{page} has {len(places)} places for the table {name}")
        start, end = places[0].span()
        text = f"{text[:start]}{made()}\n{text[end:]}"
    return text


if __name__ == "__main__":
    for page in TABLES:
        path = DOCS / page
        path.write_text(with_tables(page, path.read_text(encoding="utf-8")), encoding="utf-8")
