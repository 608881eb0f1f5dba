"""Examples of the pages in docs/."""

import re

from tests.helpers.paths import ROOT


def examples(page: str, language: str) -> list[str]:
    """The blocks of a page that are marked as of a language, in order."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
