"""Read a capture's type and settings from its file name and folder, and compute statistics of its frames."""

import itertools
import operator
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath

import numpy as np
from numpy.typing import NDArray

# Types of captures, and the words in file names that identify them.
KINDS = {
    "dark": ("dark", "darks", "cap", "lenscap", "bias", "offset"),
    "white": ("white", "whites", "flat", "flats", "flatfield", "ptc"),
    "mono": ("mono", "monos", "monochromator", "monochromatic", "sweep", "narrowband"),
    "chart": ("chart", "charts", "checker", "colorchecker", "colourchecker", "macbeth", "passport", "target"),
    "polariser": ("polariser", "polarisers", "polarizer", "polarizers"),
}
NUMBER = r"\d+(?:[.,p]\d+)?"
NM = re.compile(rf"(?<![\d.,])({NUMBER})[ _-]?nm(?![a-z])", re.IGNORECASE)
ANGLE = re.compile(rf"(?<![\d.,])({NUMBER})[ _-]?(?:deg|°)", re.IGNORECASE)
SECONDS = re.compile(rf"(?<![\d.,])({NUMBER})[ ]?(s|sec|ms|msec|us|usec|µs|μs)(?![a-zA-Z])")
FRACTION = re.compile(r"(?:(?<=^)|(?<=[_ ]))1[-/](\d{1,5})[ ]?s(?:ec)?(?![a-zA-Z])")
UNITS = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "usec": 1e-6, "µs": 1e-6, "μs": 1e-6}
LIGHT = re.compile(r"(?<![A-Za-z0-9])(A|D\d\d|FL?\d{1,2}|HP\d|LED[-_]?[A-Z0-9]+|\d{4,5}K)(?![A-Za-z0-9])")
WORD = re.compile(r"[a-z]+|[A-Z][a-z]+|[A-Z]+(?![a-z])")
# Numbers without a unit are wavelengths if all are within the range BARE (nm), and if at least LEAST_STEPS of them differ.
BARE, LEAST_STEPS = (300.0, 1200.0), 5
VISIBLE = (200.0, 2000.0)  # nm; numbers with the unit nm outside this range are not wavelengths
BLOCKS = 16  # largest number of block rows and block columns in the summary of a frame
PERIODS = (1, 2, 3, 4, 5, 6, 8)  # possible numbers of rows or columns of the filter array
LARGEST_CROP = 960  # pixels; largest side of the crop for estimating the period, a multiple of all periods
# A smaller period is preferred if it explains at least this fraction of the variance that the best period explains.
EXPLAINED = 0.98
SIGNIFICANT = 0.02  # smallest fraction of the variance that a filter array must explain
EVEN = 0.05  # largest relative residual of a uniform field after the fit of a smooth surface
TERMS = 4  # degree of the polynomial of the smooth fit
COMMON = 12  # a value that occurs in at least this many pixels is frequent
LEAST_CODES = 16  # smallest number of frequent values from which stretched values can be recognised
# In unprocessed data, the value v + 1 may be missing for at most this fraction of the frequent values v.
MOST_GAPS = 0.25
# A frame is a drawing if its values span more than DRAWN (DN), and if intermediate values occur mostly in plain areas: more
# than the fraction PLAIN of the pixels with intermediate values equal their neighbours.
PLAIN, DRAWN = 0.8, 8
Array = NDArray[np.floating]


@dataclass(frozen=True)
class Name:
    """Information extracted from a file's path. Fields are None if the path does not contain the information."""

    path: str  # path relative to the folder of captures
    kind: str | None = None  # type of the capture, a key of KINDS
    nm: float | None = None  # wavelength
    seconds: float | None = None  # exposure time
    light: str | None = None  # name of the illuminant
    angle: float | None = None  # angle of a rotating polariser in degrees
    series: str = ""  # path without its running number; the same for all frames of one exposure

    @property
    def words(self) -> frozenset[str]:
        """The words in the file name, in lower case."""
        return frozenset(word.lower() for word in WORD.findall(PurePath(self.path).stem))


def read_name(path: str) -> Name:
    """Extract the information in the path of a capture or a table of spectra.

    The file name takes precedence over folder names, and inner folders over outer folders.
    """
    pure = PurePath(path)
    stem, parts = pure.stem, (pure.stem, *reversed(pure.parent.parts))
    nm = next(filter(None, map(_wavelength, parts)), None)
    seconds = next(filter(None, map(_seconds, parts)), None)
    light = next(filter(None, map(LIGHT.search, parts)), None)
    angle = next(filter(None, map(ANGLE.search, parts)), None)
    series = re.sub(r"\d+(?=\D*$)", "#", stem, count=1)
    folder = pure.parent.as_posix()
    return Name(
        path,
        kind_of(pure),
        nm,
        seconds,
        light=light[1] if light else None,
        angle=_number(angle[1]) if angle else None,
        series=f"{folder}/{series}",
    )


def _wavelength(part: str) -> float | None:
    return next((value for value in map(_number, NM.findall(part)) if VISIBLE[0] <= value <= VISIBLE[1]), None)


def _seconds(part: str) -> float | None:
    if fraction := FRACTION.search(part):
        return 1.0 / max(int(fraction[1]), 1)
    time = SECONDS.search(part)
    return _number(time[1]) * UNITS[time[2]] if time else None


def with_bare_wavelengths(names: Sequence[Name]) -> list[Name]:
    """Find wavelengths without a unit in the names of monochromatic captures, such as 450 in mono_450_03.

    All names must contain the same number of numbers. The wavelength is the first number that is plausible in all names and
    is not a running number. If there is no such number, the names are returned unchanged.
    """
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
    """Determine a capture's type from its file name or from the names of its folders, starting with the innermost.

    A name with words for several types is ignored. Returns None if no name contains a type.
    """
    for part in (path.stem, *reversed(path.parent.parts)):
        whole = {word.lower() for word in re.findall(r"[A-Za-z]+", part)}
        words = whole | {word.lower() for word in WORD.findall(part)}
        kinds = [kind for kind, names in KINDS.items() if words & set(names)]
        if len(kinds) == 1:
            return kinds[0]
    return None


def natural(path: str) -> tuple[tuple[str | float, ...], ...]:
    """Return a sort key for paths that orders numbers by value, so that 9 comes before 10."""
    return tuple(
        tuple(float(part) if index % 2 else part.lower() for index, part in enumerate(re.split(r"([0-9]+)", each)))
        for each in PurePath(path).parts
    )


def _number(text: str) -> float:
    return float(re.sub("[,p]", ".", text))


@dataclass(frozen=True)
class Summary:
    """Statistics of a frame."""

    blocks: Array  # (block_row, block_col, site): mean value of each block in DN
    high: Array  # (site,): 90th percentile in DN
    noise: float  # median standard deviation within a block in DN
    top: int  # largest value in DN

    @property
    def level(self) -> Array:
        """Mean value of each CFA site in DN."""
        return np.asarray(self.blocks.mean(axis=(0, 1)))

    def unevenness(self, black: float) -> float:
        """Return the frame's RMS deviation from a smooth surface, relative to the mean signal.

        Only the brightest CFA site is used. `black` is the black level in DN.
        """
        rows, cols = self.blocks.shape[:2]
        y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, cols), indexing="ij")
        powers = [(i, j) for i in range(TERMS + 1) for j in range(TERMS + 1 - i)]
        design = np.stack([(y**i * x**j).ravel() for i, j in powers], axis=1)
        values = self.blocks.reshape(rows * cols, -1) - black
        left = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
        brightest = int(values.mean(axis=0).argmax())
        return float(np.sqrt(np.mean(left[:, brightest] ** 2)) / max(values[:, brightest].mean(), 1e-9))


def summarise(values: NDArray[np.uint16], period: tuple[int, int]) -> Summary:
    """Compute the statistics of a raw frame. `period` is the number of rows and columns in the CFA."""
    rows, cols = period
    down, across = (max(1, length // each // BLOCKS) for length, each in zip(values.shape, period, strict=True))
    high, wide = (min(BLOCKS, length // each) for length, each in zip(values.shape, period, strict=True))
    cut = values[: high * down * rows, : wide * across * cols].astype(np.float32)
    sites = cut.reshape(high, down, rows, wide, across, cols).transpose(0, 3, 1, 4, 2, 5)
    sites = sites.reshape(high, wide, down * across, rows * cols)
    quantile = np.quantile(sites.reshape(-1, rows * cols), 0.9, axis=0)
    return Summary(sites.mean(axis=2, dtype=np.float64), quantile, float(np.median(sites.std(axis=2))), int(values.max()))


def period_of(frames: Sequence[NDArray[np.uint16]]) -> tuple[int, int]:
    """Estimate the CFA period (rows, columns) from several frames.

    Under some illuminants, channels have equal signals, and the period seems too small. The result is therefore the largest
    period that is found in at least a third of the frames with a visible CFA. If no CFA is visible, the result is (1, 1).
    """
    found = [each for each in map(_period, frames) if each != (1, 1)]
    often = [each for each in found if len(frames) == 1 or 3 * found.count(each) >= len(found)]
    return max(often, key=lambda each: each[0] * each[1], default=(1, 1))


def _period(frame: NDArray[np.uint16]) -> tuple[int, int]:
    from scipy import ndimage

    rows, cols = (min(length, LARGEST_CROP) for length in frame.shape)
    cut = frame[:rows, :cols].astype(np.float64)
    # Neighbouring pixels receive nearly the same light, so subtracting the local mean leaves only CFA pattern and noise.
    smooth = cut - ndimage.uniform_filter(cut, 2 * max(PERIODS) + 1)
    explained = {each: _explained(smooth, each) for each in itertools.product(PERIODS, PERIODS)}
    most = max(explained.values())
    if most <= SIGNIFICANT * cut.size:
        return 1, 1
    enough = [each for each, share in explained.items() if share >= EXPLAINED * most]
    return min(enough, key=lambda each: each[0] * each[1])


def _explained(values: Array, period: tuple[int, int]) -> float:
    """Measure how well a CFA with the given period explains the variation in a frame.

    The result is n · R² − m. n is the number of pixels, R² the fraction of the variance that the site means explain, and m
    the number of sites. Without a CFA, the result is close to 0.
    """
    rows, cols = (length // each for length, each in zip(values.shape, period, strict=True))
    if min(rows, cols) < 4:
        return 0.0
    cut = values[: rows * period[0], : cols * period[1]]
    means = cut.reshape(rows, period[0], cols, period[1]).mean(axis=(0, 2))
    variance = float(cut.var()) or 1.0
    return float(rows * cols * np.sum((means - cut.mean()) ** 2) / variance / cut.size * values.size - means.size)


def altered(values: NDArray[np.uint16]) -> str | None:
    """Describe how a frame seems to have been processed, or return None if it seems to contain raw values."""
    counts = np.bincount(values.ravel())
    codes = np.flatnonzero(counts)
    step = int(np.gcd.reduce(codes))
    if step > 1 and codes.size > DRAWN:
        return f"all values are multiples of {step}, so they seem to be shifted to the left"
    # If v is a frequent value, v + 1 is not missing by chance.
    common = np.flatnonzero(counts[:-1] >= COMMON)
    gaps = float(np.mean(counts[common + 1] == 0)) if common.size else 0.0
    if common.size >= LEAST_CODES and gaps > MOST_GAPS:
        return (
            f"after {gaps:.0%} of the frequent values, the next higher value never occurs; the values seem to be stretched"
        )
    return None


def drawn(values: NDArray[np.uint16]) -> bool:
    """Return whether a frame is probably a mask or a drawing, because its intermediate values have no noise."""
    inner = values[1:, 1:]
    same = (inner == values[:-1, 1:]) & (inner == values[1:, :-1])
    low, high = int(values.min()), int(values.max())
    between = (inner > low) & (inner < high)
    return high - low > DRAWN and bool(between.mean() > 0.02) and bool(same[between].mean() > PLAIN)
