"""Text in Markdown."""

import re
from collections.abc import Iterable, Sequence


def plain(text: str) -> str:
    """Text that shows as it is written, in one line, also in a cell of a table."""
    return re.sub(r"([\\`*_{}\[\]<>#|$~])", r"\\\1", " ".join(text.split()))


def code(text: str) -> str:
    """Text as code; a bar would end the cell of a table."""
    return f"`{text.replace('|', chr(92) + '|')}`" if text else ""


def table(heading: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [heading, ["---"] * len(heading), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def page(*parts: str) -> str:
    return "\n\n".join(part for part in parts if part) + "\n"
