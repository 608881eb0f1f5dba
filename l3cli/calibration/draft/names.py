"""Kind, wavelength, exposure time, light and number from the names of captures and their folders."""

import operator
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
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
BARE, LEAST_STEPS = (300.0, 1200.0), 5  # nm without a unit, of so many steps
VISIBLE = (200.0, 2000.0)  # nm that a name may mean


@dataclass(frozen=True)
class Name:
    """Facts stated by a file's path below the folder."""

    path: str
    kind: str | None = None
    nm: float | None = None
    seconds: float | None = None
    light: str | None = None
    series: str = ""  # its folder and name without its last number: what frames of one exposure share

    @property
    def words(self) -> frozenset[str]:
        """Return the other words of the name, in lower case."""
        return frozenset(word.lower() for word in WORD.findall(PurePath(self.path).stem))


def read_name(path: str) -> Name:
    """Return the facts stated by the path of a capture or a table of spectra, relative to the folder."""
    pure = PurePath(path)
    stem, parts = pure.stem, (pure.stem, *reversed(pure.parent.parts))  # the nearest folder says more than one above
    nm = next(filter(None, map(_wavelength, parts)), None)
    seconds = next(filter(None, map(_seconds, parts)), None)
    light = next(filter(None, map(LIGHT.search, parts)), None)
    series = re.sub(r"\d+(?=\D*$)", "#", stem, count=1)
    folder = pure.parent.as_posix()
    return Name(path, kind_of(pure), nm, seconds, light[1] if light else None, f"{folder}/{series}")


def _wavelength(part: str) -> float | None:
    return next((value for value in map(_number, NM.findall(part)) if VISIBLE[0] <= value <= VISIBLE[1]), None)


def _seconds(part: str) -> float | None:
    if fraction := FRACTION.search(part):
        return 1.0 / max(int(fraction[1]), 1)
    time = SECONDS.search(part)
    return _number(time[1]) * UNITS[time[2]] if time else None


def with_bare_wavelengths(names: Sequence[Name]) -> list[Name]:
    """Return the names of monochromatic captures that state wavelengths without their unit, mono_450_03: the number in one
    place that may be light's, in steps that no counter takes."""
    bare = [name for name in names if name.kind == "mono" and name.nm is None]
    numbers = [re.findall(r"\d+(?:\.\d+)?", PurePath(name.path).stem) for name in bare]
    if not numbers or len({len(each) for each in numbers}) != 1:
        return list(names)
    for words in zip(*numbers, strict=True):
        column = [float(word) for word in words]
        steps = sorted(set(column))
        counts = any(word.startswith("0") for word in words) or min(map(operator.sub, steps[1:], steps), default=0) < 2
        if not counts and len(steps) >= LEAST_STEPS and BARE[0] <= steps[0] and steps[-1] <= BARE[1]:
            known = {id(name): replace(name, nm=nm) for name, nm in zip(bare, column, strict=True)}
            return [known.get(id(name), name) for name in names]
    return list(names)


def kind_of(path: PurePath) -> str | None:
    """Return the kind that a name or, from the nearest on, one of its folders says; None where none does, or several."""
    for part in (path.stem, *reversed(path.parent.parts)):
        whole = {word.lower() for word in re.findall(r"[A-Za-z]+", part)}
        words = whole | {word.lower() for word in WORD.findall(part)}
        kinds = [kind for kind, names in KINDS.items() if words & set(names)]
        if len(kinds) == 1:
            return kinds[0]
    return None


def natural(path: str) -> tuple[tuple[str | float, ...], ...]:
    """Return a key that sorts paths as people number them: 9 before 10."""
    return tuple(
        tuple(float(part) if index % 2 else part.lower() for index, part in enumerate(re.split(r"([0-9]+)", each)))
        for each in PurePath(path).parts
    )


def _number(text: str) -> float:
    return float(re.sub("[,p]", ".", text))
