"""Makes one physical mistake in the folder of a small lab and runs the calibration.

The calibration must name the mistake, or correct the mistake if the file states the correct unit. It must never write a
wrong camera and exit with code 0. One of 100 inputs of tests.helpers.fuzz is a physical mistake.

    python -m tests.helpers.hostile_physics FIRST COUNT     # seeds
"""

import contextlib
import functools
import io
import re
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.store import load
from l3cli.cli import run
from tests.helpers.fuzz import Seeded
from tests.helpers.hostile_inputs import CAMERA
from tests.helpers.hostile_spoiling import Choices, one_of

LAB = """
[mono]
step_nm = 10.0
bandwidth_nm = 10.0
overexposed = 1
[chart]
illuminants = ["D65", "A", "FL2"]
[white]
levels = [0.1, 0.3, 0.5, 0.8, 1.6]
trials = 2
[dark]
exposures_s = [0.01, 0.5, 1.0, 2.0]
trials = 2
"""
JOULE = 1.602176634e-19 * 1239.841984  # J nm per photon
KINDS = ("mono", "chart", "white", "dark")
WITHIN = 0.03  # tolerance of responsivities, as a fraction of the peak; three times the error without a mistake
FIGURES = {"gain": 0.05, "black_level": 0.01, "white_level": 0.01}
NOISE = {"read_noise": 0.1, "dark_current": 0.2, "prnu": 0.2}


class Folder:
    """A copy of a lab's folder in which files are changed. Text files are copies; frames are shared with the original."""

    def __init__(self, whole: Path, path: Path) -> None:
        path.mkdir()
        for kind in KINDS:
            (path / kind).symlink_to(whole / kind)
        shutil.copytree(whole / "spectra", path / "spectra")
        for name in ("camera.toml", "curves.csv", "MEASUREMENTS.toml"):
            shutil.copy(whole / name, path / name)
        self.path, self.measurements = path, path / "MEASUREMENTS.toml"

    def spectra(self, choices: Choices) -> list[Path]:
        """Return all tables of spectra, or those of one kind of capture."""
        return sorted((self.path / "spectra").glob(one_of(choices, ("*.csv", "mono.csv", "chart*.csv"))))

    def edit(self, change: Callable[[str], str]) -> None:
        text = self.measurements.read_text()
        self.measurements.write_text(change(text))


Expected = tuple[str, ...] | None  # words of the error message; None: the camera must be correct


def rewritten(path: Path, heading: Callable[[list[str]], list[str]], rows: Callable[[np.ndarray], np.ndarray]) -> None:
    """Rewrite a CSV file with another heading and other numbers (row, column)."""
    names = path.read_text().splitlines()[0].split(",")
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    lines = [",".join(heading(names)), *(",".join(f"{value:.10g}" for value in row) for row in rows(table))]
    path.write_text("\n".join(lines) + "\n")


def permuted(order: list[int]) -> tuple[Callable[[list[str]], list[str]], Callable[[np.ndarray], np.ndarray]]:
    """Return functions that reorder column names and the columns of a table."""
    return lambda names: [names[column] for column in order], lambda table: table[:, order]


def same(names: list[str]) -> list[str]:
    return names


def in_watts(table: np.ndarray, scale: float) -> np.ndarray:
    return np.column_stack([table[:, 0], table[:, 1:] * scale * JOULE / table[:, :1]])


def watts(folder: Folder, choices: Choices) -> Expected:
    """Give spectra in watts. The heading or measurement file says so, says nothing, or says photons."""
    prefix, scale = one_of(choices, (("", 1.0), ("m", 1e3), ("µ", 1e6)))
    place = one_of(choices, ("heading", "key", "unstated", "photons"))
    unit = f"{prefix}W/(sr m² nm)"
    headings: dict[str, Callable[[str], str]] = {
        "heading": lambda name: name.partition(" (")[0] + f" ({unit})",
        "photons": str,
    }
    files = folder.spectra(choices)
    name_of = headings.get(place, lambda name: name.partition(" (")[0])
    for path in files:
        rewritten(path, lambda names: [names[0], *map(name_of, names[1:])], lambda t: in_watts(t, scale))
    if place == "key":
        for path in files:
            line = re.escape(f'"spectra/{path.name}"')
            folder.edit(functools.partial(re.sub, rf"((spectrum|radiance) = {line})", rf'\1\nunit = "{unit}"'))
    return None if place in ("heading", "key") else (".csv", "unit")


def milliseconds(folder: Folder, choices: Choices) -> Expected:
    """Give all exposure times in ms or µs, in the matching key or in exposure_s."""
    unit, parts = one_of(choices, (("ms", 1e3), ("us", 1e6)))
    key = one_of(choices, (f"exposure_{unit}", "exposure_s"))
    folder.edit(lambda text: re.sub(r"exposure_s = (\S+)", lambda m: f"{key} = {float(m[1]) * parts:.9g}", text))
    return None if key != "exposure_s" else ("exposure",)


def typing_error(folder: Folder, choices: Choices) -> Expected:
    """Change one exposure time as a typing error would."""
    factor = one_of(choices, (1e3, 1e-3, 1e2, 1e-2))
    kind = one_of(choices, KINDS)
    captures = list(re.finditer(rf'frames = \["({kind}/[^"]*)".*\nexposure_s = (\S+)', folder.measurements.read_text()))
    capture = one_of(choices, captures)
    wrong = capture[0].replace(f"exposure_s = {capture[2]}", f"exposure_s = {float(capture[2]) * factor:.9g}")
    folder.edit(lambda text: text.replace(capture[0], wrong))
    return (capture[1],)


def columns_swapped(folder: Folder, choices: Choices) -> Expected:
    """Reorder the columns of spectra together with their headings. Sometimes the wavelengths are not the first column."""
    for path in folder.spectra(choices):
        width = len(path.read_text().splitlines()[0].split(","))
        order = list(range(width))
        first = choices.integer(0, 1)
        for place in range(first, width - 1):
            other = choices.integer(place, width - 1)
            order[place], order[other] = order[other], order[place]
        rewritten(path, *permuted(order))
    return None


def responsivities_swapped(folder: Folder, choices: Choices) -> Expected:
    """Reorder the curves of a camera recipe, with a matching heading or a heading that fits no channel."""
    order = one_of(choices, ([0, 3, 2, 1], [0, 2, 3, 1], [1, 2, 3, 0]))
    rewritten(folder.path / "curves.csv", *permuted(order))
    if choices.integer(0, 2):
        return None
    path = folder.path / "curves.csv"
    path.write_text(path.read_text().replace("g", "green", 1))
    return ("curves.csv", "green")


def other_wavelengths(folder: Folder, choices: Choices) -> Expected:
    """Give wavelengths in µm, Å or m, with a heading that says so, says nothing, or says nm."""
    unit, scale = one_of(choices, (("um", 1e-3), ("A", 10.0), ("µm", 1e-3), ("Å", 10.0), ("m", 1e-9)))
    stated = one_of(choices, ("stated", "unstated", "nm"))
    heading = {"stated": one_of(choices, (f"wavelength_{unit}", f"wavelength ({unit})")), "unstated": "wavelength"}
    name = heading.get(stated, "wavelength_nm")
    for path in folder.spectra(choices):
        rewritten(path, lambda names: [name, *names[1:]], lambda t: t * [scale, *[1] * (t.shape[1] - 1)])
    return None if stated == "stated" else (".csv", "wavelength")


def rows_reversed(folder: Folder, choices: Choices) -> Expected:
    for path in folder.spectra(choices):
        rewritten(path, same, lambda table: table[::-1])
    return None


def decimal_commas(folder: Folder, choices: Choices) -> Expected:
    """Write numbers with decimal commas, as spreadsheets in many countries do. Between commas they are ambiguous."""
    separator = one_of(choices, (";", "\t", ","))
    for path in folder.spectra(choices):
        heading, *lines = path.read_text().splitlines()
        cells = [separator.join(cell.replace(".", ",") for cell in line.split(",")) for line in lines]
        path.write_text("\n".join([heading.replace(",", separator), *cells]) + "\n")
    return (".csv",) if separator == "," else None


def percents(folder: Folder, choices: Choices) -> Expected:
    """Give percentages instead of fractions, and lengths in other units."""
    wrongs = {
        "peak_efficiency": ("40", "1.2"),
        "prnu": ("0.5", "1"),
        "pixel_pitch_um": ("0.004", "4e-6"),
        "f_number": ("0.28",),
    }
    key = one_of(choices, sorted(wrongs))
    wrong = one_of(choices, wrongs[key])
    path = folder.path / "camera.toml"
    path.write_text(re.sub(rf"{key} = \S+", f"{key} = {wrong}", path.read_text()))
    return ("camera.toml", key)


def pitch(folder: Folder, choices: Choices) -> Expected:
    """Give the pixel pitch or the focal length in another unit."""
    key, wrong = one_of(choices, (("pixel_pitch_um", "0.004"), ("focal_length_mm", "0.025"), ("f_number", "0.28")))
    folder.edit(lambda text: re.sub(rf"{key} = \S+", f"{key} = {wrong}", text))
    return (key,)


MISTAKES: tuple[Callable[[Folder, Choices], Expected], ...] = (
    watts, milliseconds, typing_error, columns_swapped, responsivities_swapped, other_wavelengths, rows_reversed,
    decimal_commas, percents, pitch,
)  # fmt: skip


class Lab:
    """A valid lab, and a place where changed copies of it are calibrated."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.whole = folder, folder / "whole"
        self.whole.mkdir(parents=True)
        (self.whole / "camera.toml").write_text(CAMERA.replace("[400, 700, 10]", "[400, 700, 5]"))
        (self.whole / "lab.toml").write_text(LAB)
        self.truth = load_camera(self.whole / "camera.toml")
        words = self.words("lab", self.whole / "camera.toml", "--recipe", self.whole / "lab.toml", "-o", self.whole)
        assert words[0] == 0, words
        rows = np.column_stack([self.truth.wavelength, self.truth.responsivity.T])
        text = "\n".join(",".join(f"{value:.10g}" for value in row) for row in rows)
        (self.whole / "curves.csv").write_text("wavelength_nm,r,g,b\n" + text + "\n")
        (self.whole / "camera.toml").write_text(
            re.sub(
                r"\[responsivity.gaussians\].*?(?=\[noise\])",
                "",
                CAMERA.replace("[400, 700, 10]", "[400, 700, 5]").replace("0.4\n", '0.4\nfile = "curves.csv"\n', 1),
                flags=re.S,
            )
        )

    def words(self, *arguments: object) -> tuple[int, str]:
        """Return the exit code and stderr of a command."""
        stderr = io.StringIO()
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(stderr):
            code = run([*map(str, arguments), "--quiet"])
        return code, stderr.getvalue()

    def judge(self, mistake: Callable[[Folder, Choices], Expected], choices: Choices) -> str | None:
        """Make a mistake in a copy of the lab, and return what went wrong, or None."""
        path = Path(tempfile.mkdtemp(dir=self.folder)) / "lab"
        try:
            folder = Folder(self.whole, path)
            expected = mistake(folder, choices)
            code, line = self.words("calibrate", folder.measurements, "-o", path / "camera.h5")
            if mistake in (responsivities_swapped, percents):
                code, line = self.words("lab", path / "camera.toml", "--recipe", self.whole / "lab.toml", "-o", path / "new")
            if expected is None:
                return f"refused: {line}" if code else self._wrong(path, mistake is responsivities_swapped)
            if code == 0:
                return self._wrong(path, False)
            named = all(word in line for word in expected)
            return None if named and line.startswith("l3: ") and line.count("\n") == 1 else f"names no {expected}: {line}"
        finally:
            shutil.rmtree(path.parent)

    def _wrong(self, path: Path, described: bool) -> str | None:
        """Return how far the calibrated camera is from the truth, or None if it is right."""
        camera = load_camera(path / "camera.toml") if described else load(CameraModel, path / "camera.h5")
        real = np.array([np.interp(camera.wavelength, self.truth.wavelength, row, 0, 0) for row in self.truth.responsivity])
        off = float(np.abs(camera.responsivity - real).max() / real.max())
        if not off < WITHIN:
            return f"a wrong camera: responsivity off by {off:.3g} of its peak"
        for figures, holder, true in ((FIGURES, camera, self.truth), (NOISE, camera.noise, self.truth.noise)):
            for name, within in figures.items():
                value, right = getattr(holder, name), getattr(true, name)
                if not abs(value / right - 1.0) < within:
                    return f"a wrong camera: {name} is {value:.4g}, not {right:.4g}"
        return None


def judge_seeds(seeds: Iterable[int]) -> Iterator[tuple[int, str]]:
    """Yield each seed whose mistake was not handled correctly, with the result."""
    with tempfile.TemporaryDirectory(prefix="l3-physics-") as name:
        lab = Lab(Path(name) / "lab")
        for seed in seeds:
            choices = Seeded(seed)
            mistake = one_of(choices, MISTAKES)
            if (verdict := lab.judge(mistake, choices)) is not None:
                yield seed, f"{mistake.__name__}: {verdict}"
