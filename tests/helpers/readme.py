"""README, and the commands that it shows."""

import re
import shlex

from tests.helpers.paths import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")


def commands(line: str) -> list[list[str]]:
    """The `l3` commands of a line of shell, as lists of words."""
    parts = re.split(r"\s(?:\||&&)\s", line.partition("   #")[0].partition("  →")[0])
    return [words[1:] for part in parts if (words := shlex.split(part)) and words[0] == "l3"]


def sessions() -> list[list[tuple[str, list[str]]]]:
    """Blocks with `$ l3 …`: each command with the lines shown below it."""
    blocks: list[list[tuple[str, list[str]]]] = []
    inside = False
    for line in README.splitlines():
        if line.startswith("    $ l3 "):
            if not inside:
                blocks.append([])
            blocks[-1].append((line[6:], []))
        elif line.startswith("    ") and inside:
            blocks[-1][-1][1].append(line[4:])
        inside = line.startswith("    $ l3 ") or (inside and line.startswith("    "))
    return blocks
