"""What the names of captures and their folders say: kind, wavelength, exposure time, light, number."""

import re
from dataclasses import dataclass
from pathlib import PurePath

KINDS = {
    "dark": ("dark", "darks", "cap", "lenscap", "bias", "offset"),
    "white": ("white", "whites", "flat", "flats", "flatfield", "ptc"),
    "mono": ("mono", "monos", "monochromator", "monochromatic", "sweep", "narrowband"),
    "chart": ("chart", "charts", "checker", "colorchecker", "colourchecker", "macbeth", "passport", "target"),
}
NUMBER = r"\d+(?:[.,p]\d+)?"
NM = re.compile(rf"(?<![\d.,])({NUMBER})[ _-]?nm(?![a-z])", re.IGNORECASE)
SECONDS = re.compile(rf"(?<![\d.,])({NUMBER})[ ]?(s|sec|ms|msec|us|usec|µs|μs)(?![a-zA-Z])")
FRACTION = re.compile(r"(?:(?<=^)|(?<=[_ ]))1[-/](\d{1,5})[ ]?s(?:ec)?(?![a-zA-Z])")
UNITS = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "usec": 1e-6, "µs": 1e-6, "μs": 1e-6}
LIGHT = re.compile(r"(?<![A-Za-z0-9])(A|D\d\d|FL?\d{1,2}|HP\d|LED[-_]?[A-Z0-9]+|\d{4,5}K)(?![A-Za-z0-9])")
WORD = re.compile(r"[a-z]+|[A-Z][a-z]+|[A-Z]+(?![a-z])")
VISIBLE = (200.0, 2000.0)  # nm that a name may mean


@dataclass(frozen=True)
class Name:
    """What a file's path below the folder says."""

    path: str
    kind: str | None = None
    nm: float | None = None
    seconds: float | None = None
    light: str | None = None
    series: str = ""  # its folder and name without its last number: what frames of one exposure share

    @property
    def words(self) -> frozenset[str]:
        """What else is in the name, in lower case."""
        return frozenset(word.lower() for word in WORD.findall(PurePath(self.path).stem))


def read_name(path: str) -> Name:
    """What the path of a capture or a table of spectra says, relative to the folder."""
    pure = PurePath(path)
    stem = pure.stem
    nm = next((value for value in map(_number, NM.findall(stem)) if VISIBLE[0] <= value <= VISIBLE[1]), None)
    seconds = None
    if fraction := FRACTION.search(stem):
        seconds = 1.0 / max(int(fraction[1]), 1)
    elif time := SECONDS.search(stem):
        seconds = _number(time[1]) * UNITS[time[2]]
    light = LIGHT.search(stem)
    series = re.sub(r"\d+(?=\D*$)", "#", stem, count=1)
    folder = pure.parent.as_posix()
    return Name(path, kind_of(pure), nm, seconds or None, light[1] if light else None, f"{folder}/{series}")


def kind_of(path: PurePath) -> str | None:
    """The kind that a name or, from the nearest on, one of its folders says; None where none does, or several."""
    for part in (path.stem, *reversed(path.parent.parts)):
        whole = {word.lower() for word in re.findall(r"[A-Za-z]+", part)}
        words = whole | {word.lower() for word in WORD.findall(part)}
        kinds = [kind for kind, names in KINDS.items() if words & set(names)]
        if len(kinds) == 1:
            return kinds[0]
    return None


def natural(path: str) -> tuple[tuple[str | float, ...], ...]:
    """A key that sorts paths as people number them: 9 before 10."""
    return tuple(
        tuple(float(part) if index % 2 else part.lower() for index, part in enumerate(re.split(r"([0-9]+)", each)))
        for each in PurePath(path).parts
    )


def _number(text: str) -> float:
    return float(re.sub("[,p]", ".", text))
