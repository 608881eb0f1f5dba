"""The README and the pages in docs/, and the commands that they show."""

import re
import shlex

from tests.helpers.paths import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = {path.name: path.read_text(encoding="utf-8") for path in sorted((ROOT / "docs").glob("*.md"))}
ALL = "\n\n".join([README, *PAGES.values()])


def shown(text: str) -> list[str]:
    """Return the lines of all indented or fenced code blocks of a page."""
    lines, fenced = [], False
    for line in text.splitlines():
        if line.startswith("```"):
            fenced = not fenced
        elif fenced:
            lines.append(line)
        elif line.startswith("    "):
            lines.append(line[4:])
    return lines


def blocks(text: str) -> list[str]:
    """Return the code blocks of a page. Consecutive indented or fenced lines form a block, which may contain blank lines."""
    found = re.findall(
        r"(?:^(?: {4}.*)?\n)+", re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL), re.MULTILINE
    )
    marked = re.findall(r"^```.*?^```$", text, re.MULTILINE | re.DOTALL)
    return [block for each in (*found, *marked) if (block := "\n".join(shown(each))).strip()]


def fenced(text: str, language: str) -> list[str]:
    """Return the code blocks of a page in a given language, in order."""
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def commands(line: str) -> list[list[str]]:
    """Return the `l3` commands in a line of shell, each as a list of words."""
    parts = re.split(r"\s(?:\||&&)\s", line.partition("   #")[0].partition("  →")[0])
    return [words[1:] for part in parts if (words := shlex.split(part)) and words[0] == "l3"]


def sessions(text: str) -> list[list[tuple[str, list[str]]]]:
    """Return the blocks of a page with `$ l3 …`: each command with the output lines shown below it."""
    blocks: list[list[tuple[str, list[str]]]] = []
    inside = False
    for line in text.splitlines():
        if line.startswith("    $ l3 "):
            if not inside:
                blocks.append([])
            blocks[-1].append((line[6:], []))
        elif line.startswith("    ") and inside:
            blocks[-1][-1][1].append(line[4:])
        inside = line.startswith("    $ l3 ") or (inside and line.startswith("    "))
    return blocks
