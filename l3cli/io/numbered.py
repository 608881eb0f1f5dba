"""Names of files with numbers: patterns such as frame_%04d.tif and frame_####.tif, and the order of numbered names."""

import re
from pathlib import Path
from typing import Any

RAW, IDEAL, MOTION = "_raw.tif", "_ideal.png", "_motion.exr"  # ends of the names that a simulation gives
MOST_DIGITS = 18  # of a number: enough for the time to a microsecond, within 64 bits
PATTERN = re.compile(r"%(0[0-9]{1,2})?d|#{1,99}")  # no wider than names are
DIGITS = re.compile(r"[0-9]+")  # of a number: not those of every script, some of which are no digits to Python


def natural_order(path: Path) -> tuple[Any, ...]:
    """Sorts 9 before 10."""
    return tuple((int(part), part) if DIGITS.fullmatch(part) else (0, part) for part in re.split(r"([0-9]+)", str(path)))


def last_number(path: Path) -> int | None:
    """Return the last number in a file's name."""
    numbers = DIGITS.findall(path.stem)
    return int(numbers[-1]) if numbers and len(numbers[-1]) <= MOST_DIGITS else None


def numbered_name(pattern: Path, number: int) -> Path:
    """Return the pattern's file of a number: %d, %04d or a run of # in its name stands for it."""

    def digits(field: re.Match[str]) -> str:
        width = len(field[0]) if field[0][0] == "#" else int(field[1] or 0)
        return f"{number:0{width}d}"

    return pattern.with_name(PATTERN.sub(digits, pattern.name, count=1))


def numbered_files(pattern: Path) -> dict[int, Path]:
    """Return the files that exist of a pattern, by number, in order."""
    where = PATTERN.search(pattern.name)
    if where is None or not pattern.parent.is_dir():
        return {}
    spelled = re.compile(
        f"{re.escape(pattern.name[: where.start()])}([0-9]{{1,{MOST_DIGITS}}}){re.escape(pattern.name[where.end() :])}"
    )
    files = {}
    for path in pattern.parent.iterdir():
        match = spelled.fullmatch(path.name)
        if match and numbered_name(pattern, int(match[1])).name == path.name:
            files[int(match[1])] = path
    return dict(sorted(files.items()))
