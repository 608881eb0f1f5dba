"""Write Markdown."""

import re
from collections.abc import Iterable, Sequence


def plain(text: str) -> str:
    """Escape a text for Markdown, and join its lines so that it fits into a table cell."""
    return re.sub(r"([\\`*_{}\[\]<>#|$~])", r"\\\1", " ".join(text.split()))


def code(text: str) -> str:
    """Return a text as inline code. Vertical bars are escaped, because they would end a table cell."""
    return f"`{text.replace('|', chr(92) + '|')}`" if text else ""


def table(heading: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [heading, ["---"] * len(heading), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def page(*parts: str) -> str:
    return "\n\n".join(part for part in parts if part) + "\n"
