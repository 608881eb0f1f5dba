"""Compose a draft measurement file from the frames and tables of spectra in a folder."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import F_NUMBER, FOCAL_MM, PITCH_UM, CfaRecipe, optics_recipe
from l3cli.calibration.draft import sorting
from l3cli.calibration.draft.sorting import (
    Group,
    Scale,
    Spectra,
    columns_of,
    match_charts,
    match_light,
    match_steps,
    note_unused,
    radiances,
    unknown_unit,
)
from l3cli.errors import listed
from l3cli.physics.mosaic import array_rows
from l3cli.recipes.toml import toml_key, toml_value
from l3cli.spectra.table import CurveTable
from l3cli.spectra.units import PHOTON_RADIANCE, POWER_RADIANCE
from l3cli.system.text import printable

COLUMN = 54  # column at which comments begin
HEAD = "Draft: complete the lines marked TODO, check the lines marked ASSUMED, then run l3 calibrate on this file."
LAMP = (
    "If you measured the brightness of the lamp during a capture, set monitor to this reading divided by the reading during",
    "the measurement of its spectrum. At the end of the file, you can state the uncertainty of lamp and monochromator:",
    "[uncertainty] lamp_drift = 0.01 (relative), wavelength_nm = 0.1",
)
PITCH = "µm; distance between pixels, from the data sheet"
LEAST_CHARTS = 2  # a fit of gain and offset needs at least this number of charts
CORNERS = [[10, 10], [240, 10], [240, 170], [10, 170]]  # example of chart corners: column and row in pixels
SHARING = ("[[mono]]", "[[band]]")  # types of captures to which the [common] section applies
SEVERAL = 2  # if at least this many captures lack a key, it is written once, in [common]
EXAMPLE_SPECTRUM = "spectra/mono.csv"
PAIR = 2  # a measurement of noise needs at least this number of frames
Mosaic = NDArray[np.floating]


class DraftText:
    """The text of a measurement file. Its methods add tables, keys and comments."""

    def __init__(self) -> None:
        self._lines: list[str] = []
        self.assumed: list[str] = []  # messages about assumed values, which the user should check
        # (key, capture or section that needs it, explanation) of each missing key
        self._missing: list[tuple[str, str, str]] = []

    def __str__(self) -> str:
        return "\n".join(self._lines) + "\n"

    def table(self, heading: str, **keys: Any) -> None:
        """Begin a section such as [sensor], or an entry such as [[mono]], and add its keys."""
        self._lines += ["", heading]
        for name, value in keys.items():
            self.key(name, value)

    def head(self, *lines: str) -> None:
        """Add comments at the top of the file."""
        self._lines[:0] = [f"# {printable(line)}" for line in lines]

    def comment(self, *lines: str) -> None:
        self._lines += [f"# {printable(line)}".rstrip("# ") if not line else f"# {printable(line)}" for line in lines]

    def key(self, name: str, value: Any, comment: str = "") -> None:
        self._line(f"{name} = {toml_value(value)}", comment)

    def assume(self, name: str, value: Any, why: str, announced: bool = True) -> None:
        """Add a key with a probable value, marked ASSUMED, and list it in `assumed` if `announced` is true."""
        self._line(f"{name} = {toml_value(value)}", f"ASSUMED: {why}")
        if announced:
            self.assumed.append(f"{name} = {toml_value(value)}: {why}")

    def todo(self, name: str, example: Any, what: str, where: str) -> None:
        """Add a commented-out key with an example, marked TODO, because only the user knows the value.

        `what` explains the value. `where` is the capture, file or section to which the key belongs.
        """
        self._line(f"# TODO {name} = {toml_value(example)}", what)
        self._missing.append((name, where, what))

    def fill(self, name: str, value: Any, what: str, where: str) -> None:
        """Add a key, marked TODO, with the name of a file that the user must create."""
        self._line(f"{name} = {toml_value(value)}", f"TODO: {what}")
        self._missing.append((name, where, what))

    def todo_table(self, heading: str, what: str, *keys: tuple[str, Any]) -> None:
        """Add a missing section and its keys as comments, marked TODO."""
        self._lines += ["", f"# TODO {heading}  # {printable(what)}"]
        self._lines += [f"# {name} = {toml_value(value)}" for name, value in keys]
        self._missing.append((heading, "", what))

    @property
    def missing(self) -> list[str]:
        """One line for each key that the user must fill in. If several captures lack a key, they share a line."""
        alike: dict[tuple[str, str], list[str]] = {}
        for name, where, what in self._missing:
            alike.setdefault((name, re.sub(r"\d[\d.e+-]*", "#", what)), []).append(where)
        reasons = {(name, re.sub(r"\d[\d.e+-]*", "#", what)): what for name, _, what in reversed(self._missing)}
        return [
            f"{key[0]}{' of ' * bool(where[0])}{where[0]}{f' and {len(where) - 1} more' * (len(where) > 1)}: {reasons[key]}"
            for key, where in alike.items()
        ]

    def _line(self, text: str, comment: str) -> None:
        self._lines.append(f"{text:{COLUMN}}  # {printable(comment)}" if comment else text)


@dataclass(frozen=True)
class Survey:
    """Contents of a folder of captures."""

    shape: tuple[int, int]  # rows and columns of the frames
    period: tuple[int, int]  # number of rows and columns in the CFA
    array: CfaRecipe | None  # colour filter array, from the metadata
    black_level: float | None  # DN; from the metadata
    white_level: float | None  # DN; from the metadata
    scale: Scale
    groups: list[Group]
    tables: list[Spectra]
    notes: list[str] = field(default_factory=list)  # remarks for the user, which become comments in the draft

    @property
    def top(self) -> int:
        """Largest raw value of all frames in DN."""
        return max(frame.summary.top for group in self.groups for frame in group.frames)

    @property
    def black(self) -> float:
        """Black level in DN, from the metadata if they contain it, otherwise from the darkest frames."""
        return float(self.scale.black.mean()) if self.black_level is None else self.black_level

    def groups_of(self, *kinds: str) -> list[Group]:
        """Return the captures of the given types."""
        return [group for group in self.groups if group.kind in kinds]


# ----------------------------------------------------------------------------------------------------------- camera


def known_body(out: DraftText, camera: CameraModel) -> None:
    """Add the sections [sensor], [cfa] and [optics] with the values of a known camera."""
    out.table("[sensor]", rows=camera.rows, cols=camera.cols, pixel_pitch_um=round(camera.pixel_pitch * 1e6, 9))
    out.key("bits", camera.bits)
    out.table("[cfa]", channels=list(camera.channels), pattern=array_rows(camera.channels, camera.cfa))
    out.table("[optics]", **msgspec.structs.asdict(optics_recipe(camera.optics)))


def unknown_optics(out: DraftText) -> None:
    """Add the [optics] section with keys that the user must fill in."""
    out.table("[optics]")
    out.todo("focal_length_mm", 25.0, "mm; focal length of the lens", "[optics]")
    out.todo("f_number", 4.0, "f-number that was set on the lens", "[optics]")


def _seen_body(out: DraftText, seen: Survey, photo: bool) -> None:
    """Add the sections [sensor], [cfa] and [optics], with values determined from the frames.

    If the captures are photos of charts (`photo`), the pixel pitch and the optics do not affect the result, so typical
    values are assumed.
    """
    out.table("[sensor]", rows=seen.shape[0], cols=seen.shape[1])
    if photo:
        out.assume("pixel_pitch_um", PITCH_UM, "µm; has no influence on curves from photos")
    else:
        out.todo("pixel_pitch_um", 3.45, PITCH, "[sensor]")
    white, top = seen.white_level, seen.top
    bits = max(1, int(np.ceil(np.log2(max(top, white or 0) + 1))))
    why = f"the white level in the files is {white:g} DN" if white else f"the largest value of all frames is {top} DN"
    out.assume("bits", bits, why)
    rows, cols = seen.period
    out.table("[cfa]")
    if seen.array is not None:
        out.key("channels", seen.array.channels)
        out.key("pattern", seen.array.pattern, "from the metadata of the files")
    elif guessed := sorting.guess_array(seen.groups_of("mono"), seen.scale, seen.period):
        why = f"sites of the {rows}×{cols} array with equal responses, named by their peak wavelength"
        out.assume("channels", guessed.channels, why)
        out.assume("pattern", guessed.pattern, why, announced=False)
    else:
        what = f"channel names, row by row; the array repeats every {rows}×{cols} pixels"
        what = what if rows * cols > 1 else "channel names, row by row"
        out.todo("channels", ["r", "g", "b"], "names of the channels of the colour filter array", "[cfa]")
        out.todo("pattern", ["r g", "g b"], what, "[cfa]")
    if photo:
        out.table("[optics]")
        out.assume("focal_length_mm", FOCAL_MM, "mm; has no influence on curves from photos", announced=False)
        out.assume("f_number", F_NUMBER, "has no influence on curves from photos", announced=False)
    else:
        unknown_optics(out)


class Composer:
    """Composes the draft of a measurement file for a folder.

    Parameters
    ----------
    seen : Survey
        Contents of the folder.
    camera : CameraModel or None
        The camera, if it is known.
    folder : str
        Folder of the frames, as written in the draft. "." is the folder of the draft itself.
    read : callable
        Function from the path of a frame to its raw values.
    """

    def __init__(self, seen: Survey, camera: CameraModel | None, folder: str, read: Callable[[str], Mosaic]) -> None:
        self.seen, self.camera, self.folder, self.read = seen, camera, folder, read
        self.out = DraftText()
        self.shared: set[str] = set()  # keys that are already explained in the draft, in [common] or for the first capture
        self.steps, self.bands = seen.groups_of("mono"), seen.groups_of("band")
        self.charts = seen.groups_of("chart", "structured")
        self.whites, self.darks = seen.groups_of("white"), seen.groups_of("dark")
        if self.steps and self.bands:  # a file can contain only one of the two, and monochromatic captures are more accurate
            seen.notes.append(
                f"skipped {len(self.bands)} captures of a chart through filters, because there are monochromatic captures"
            )
            self.bands = []

    def text(self, name: str) -> DraftText:
        """Compose the whole draft. `name` is the name of the camera if the camera is unknown."""
        out = self.out
        corners = self._chart_corners()
        if self.camera is not None:
            out.key("name", self.camera.name)
            known_body(out, self.camera)
        else:
            out.assume("name", name, "the name of the folder", announced=False)
            _seen_body(out, self.seen, photo=not self.steps and not self.bands and bool(self.charts))
        if self.steps:
            self._mono()
            self._charts(corners)
        elif self.bands:
            self._bands()
        else:
            self._photos(corners)
        if not self.steps and not self.bands and not self.charts:
            what = "responsivities, because the folder contains no monochromatic captures, charts or curves"
            out.todo_table("[curves]", what, ("file", "curves.csv"), ("per_energy", True))
        self._sensor_frames()
        self._polarisers()
        unused = [table.name.path for table in self.seen.tables if toml_value(table.path) not in str(out)]
        if unused:
            self.seen.notes.append(f"unused tables of spectra: {listed(unused)}")
        out.head(HEAD, *self.seen.notes)
        return out

    # -------------------------------------------------------------------------------------------------- captures

    def _common(self, group: Group, heading: str) -> None:
        """Begin the entry of a capture, with its frames and exposure time."""
        out, first = self.out, group.first
        out.table(heading, frames=self._names(group))
        if first.seconds is not None:
            out.key("exposure_s", float(f"{first.seconds:.6g}"), "from the file name" if first.by_name else "")
        elif "exposure_s" not in self.shared or heading not in SHARING:
            out.todo("exposure_s", 0.01, "s; neither the file nor its name contains the exposure time", first.name.path)

    def _names(self, group: Group) -> list[str]:
        prefix = "" if self.folder == "." else f"{self.folder}/"
        return [f"{prefix}{frame.name.path}" for frame in group.frames]

    def _mono(self) -> None:
        out, seen = self.out, self.seen
        columns = columns_of(seen.tables)
        matched = match_steps(self.steps, columns, seen.scale, seen.notes)
        units = [each.spectra.path for each in matched if each and unknown_unit(each.spectra.table, each.number - 1)]
        self._share(self.steps, units, POWER_RADIANCE)
        out.comment("", *LAMP)
        for number, (step, column) in enumerate(zip(self.steps, matched, strict=True), 1):
            self._common(step, "[[mono]]")
            path, nm = step.first.name.path, step.first.name.nm
            uneven = step.first.summary.unevenness(float(seen.scale.black.mean()))
            if uneven > 4 * sorting.DIM and not seen.scale.clipped(step):
                out.comment(f"The illumination varies by {uneven:.0%} over the frame, but [[mono]] needs a uniform field.")
            if not columns and len(matched) >= SEVERAL:
                what = "make this table, with one column of radiances per [[mono]], or write the name of your table"
                self._wanted("spectrum", EXAMPLE_SPECTRUM, what, path)
                out.key("column", number if nm is None else f"{nm:g}nm")
            elif column is None:
                out.todo("spectrum", EXAMPLE_SPECTRUM, "measured radiance", path)
            else:
                out.key("spectrum", column.spectra.path)
                out.key("column", column.key, "" if nm is not None else f"ASSUMED by order: {column.nm:g} nm")
                self._unit(column.spectra.table, column.number - 1)
        note_unused(columns, matched, seen.notes)

    def _share(self, groups: Sequence[Group], unitless: Sequence[str], unit: str) -> None:
        """Add the [common] section with the keys that several captures lack, marked TODO.

        These can be the exposure time and the unit of radiances. `unitless` lists the captures or tables in which radiances
        have no unit.
        """
        out, untimed = self.out, [group for group in groups if group.first.seconds is None]
        if len(untimed) < SEVERAL and len(unitless) < SEVERAL:
            return
        out.table("[common]")
        if len(untimed) >= SEVERAL:
            self.shared.add("exposure_s")
            what = f"s; exposure time of {len(untimed)} captures; if a capture differs, set exposure_s there"
            out.todo("exposure_s", 0.01, what, untimed[0].first.name.path)
        if len(unitless) >= SEVERAL:
            self.shared.add("unit")
            what = f"unit of the radiances of {len(unitless)} captures, because the headings contain no unit"
            out.todo("unit", unit, what, unitless[0])

    def _wanted(self, key: str, example: str, what: str, where: str) -> None:
        """Add a key for a CSV file that the user must create. Its explanation is added only once."""
        if key in self.shared:
            self.out.key(key, example, "as above")
        else:
            self.out.fill(key, example, what, where)
            self.shared.add(key)

    def _unit(self, table: CurveTable, column: int | None) -> None:
        """Add the unit of radiances if the table headings do not contain it.

        If the values are typical of photon radiance, this unit is assumed. Otherwise, the unit is added as a TODO, unless
        `column` is set and [common] already contains the unit.
        """
        if unknown_unit(table, column):
            if column is None or "unit" not in self.shared:
                peak = radiances(table, column).max()
                what = f"the heading contains no unit; the peak is {peak:.3g}"
                self.out.todo("unit", POWER_RADIANCE, what, table.path.name)
        elif not any(table.units):
            why = "the heading contains no unit, but the values are typical of photon radiances"
            self.out.assume("unit", PHOTON_RADIANCE, why, False)

    def _chart_corners(self) -> dict[int, sorting.Corners]:
        """Find the chart in each capture in `self.charts`, and return its corners by the `id()` of the capture.

        If a capture contains no chart, it is removed from `self.charts`, unless its name says that it shows a chart.
        """
        seen, found = self.seen, dict[int, sorting.Corners]()
        for group in list(self.charts):
            corners = sorting.find_corners(self.read(group.first.name.path) - seen.black, seen.period)
            if corners is not None:
                found[id(group)] = corners
            elif group.kind == "structured":
                self.charts.remove(group)
                seen.notes.append(f"skipped {group.first.name.path}, which contains neither a uniform field nor a chart")
        return found

    def _corners(self, corners: sorting.Corners | None, path: str) -> None:
        if corners is not None:
            self.out.key("corners", corners, "found")
        else:
            what = "l3 found no chart; write the column and row of the outer corners of patches 1, 6, 24 and 19"
            self.out.todo("corners", CORNERS, what, path)

    def _charts(self, corners: dict[int, sorting.Corners]) -> None:
        """Add the [[chart]] captures of a folder with monochromatic captures, each with its table of radiances.

        A missing table is added as a TODO.
        """
        out, seen = self.out, self.seen
        tables = match_charts(self.charts, seen.tables, seen.notes)
        for number, (group, table) in enumerate(zip(self.charts, tables, strict=True), 1):
            path = group.first.name.path
            self._common(group, "[[chart]]")
            light = group.first.name.light or (table.name.light if table else None)
            if light:
                out.key("illuminant", light)
            else:
                out.assume("illuminant", f"light {number}", "a name for reports", announced=False)
            self._corners(corners.get(id(group)), path)
            if table is None:
                example = f"spectra/chart_{light or number}.csv"
                out.todo("radiance", example, "CSV file with the measured radiances, one column per patch", path)
            else:
                named = table.name.light and table.name.light == light
                out.key("radiance", table.path, "" if named else "ASSUMED by order")
                self._unit(table.table, None)

    def _bands(self) -> None:
        """Add the [[band]] captures, which show a chart through narrow-band filters.

        The corners of the chart are found in the brightest captures, and apply to all captures. A missing table of radiances
        is added as a TODO.
        """
        out, seen = self.out, self.seen
        corners = sorting.corners_of_series(self.bands, seen.scale, seen.period, self.read)
        by_band = {table.name.nm: table for table in reversed(seen.tables) if table.has_patches}
        lacking = [f"{nm:g} nm" for group in self.bands if (nm := group.first.name.nm) not in by_band]
        self._share(self.bands, lacking, "relative power")
        for group in self.bands:
            path, nm = group.first.name.path, group.first.name.nm
            self._common(group, "[[band]]")
            out.key("illuminant", f"{nm:g} nm")
            self._corners(corners, path)
            if nm in by_band:
                out.key("radiance", by_band[nm].path)
                self._unit(by_band[nm].table, None)
                continue
            what = (
                "make this table, with illuminant × reflectance of each patch in 24 columns, or write the name of your table"
            )
            self._wanted("radiance", f"spectra/{nm:g}nm.csv", what, path)
            if "unit" not in self.shared:
                out.todo("unit", "relative power", "unit of the radiances, because the heading contains no unit", path)

    def _photos(self, corners: dict[int, sorting.Corners]) -> None:
        """Add the [[photo]] captures: charts in a folder without monochromatic captures.

        A photo's illuminant is a matching measured spectrum, or the illuminant in the file name. If both are missing, a
        comment explains the key `light`. Dark frames with the same exposure time are added to the photo. If there are none
        and the black level is unknown, they become a TODO.
        """
        out, seen = self.out, self.seen
        for group in self.charts:
            path = group.first.name.path
            out.table("[[photo]]", frames=self._names(group))
            light, (measured, named) = group.first.name.light, match_light(group, seen.tables)
            if measured is not None and named:
                out.key("light", measured.path)
            elif measured is not None:
                out.assume("light", measured.path, "the only measured illuminant in the folder")
            elif light:
                out.assume("light", light, "from the file name")
            else:
                out.comment(
                    'light = "D65"  or "3200K", or a CSV file with the spectrum; otherwise l3 guesses the illuminant'
                )
            self._corners(corners.get(id(group)), path)
            same = [dark for dark in self.darks if dark.first.seconds == group.first.seconds]
            if same and not (self.whites and self.darks):
                out.key("dark", self._names(same[0]))
            elif seen.black_level is None and not same:
                what = "frames without light and with the same exposure time, because no file contains the black level"
                out.todo("dark", ["dark.tif"], what, path)

    # ---------------------------------------------------------------------------------------------------- sensor

    def _sensor_frames(self) -> None:
        """Add the [[white]] and [[dark]] captures and, for captures through filters, the [datasheet] section.

        Missing captures are added as TODOs, including [[chart]] captures if there are monochromatic captures. A draft with
        only photos needs none of these entries.
        """
        out = self.out
        if self.steps and len(self.charts) < LEAST_CHARTS:
            what = (
                f"the calibration needs charts under {LEAST_CHARTS} illuminants or more; the folder has {len(self.charts)}"
            )
            common = (("frames", ["chart_A.tif"]), ("exposure_s", 0.01), ("illuminant", "A"))
            out.todo_table("[[chart]]", what, *common, ("corners", CORNERS), ("radiance", "chart_A.csv"))
        if self.bands:
            figures = (("black_level_dn", round(self.seen.black)), ("white_level_dn", self.seen.top))
            further = (("well_capacity_e", 10000), ("read_noise_e", 5.0))
            out.todo_table("[datasheet]", "levels and noise of the sensor, from its data sheet", *figures, *further)
            self._list("dark", self.darks)
        elif self.steps or not self.charts or (self.whites and self.darks):
            self._list("white", self.whites)
            self._list("dark", self.darks)
            example = (("frames", ["a_1.tif", "a_2.tif"]), ("exposure_s", 0.01))
            if not self.whites:
                what = "uniform light, with several exposure times up to saturation, two frames per exposure time"
                out.todo_table("[[white]]", what, *example)
            if not self.darks:
                what = "no light, with at least two exposure times, two frames per exposure time"
                out.todo_table("[[dark]]", what, *example)

    def _polarisers(self) -> None:
        """Add the [[polariser]] captures. If a file name does not contain the angle, the angle is added as a TODO."""
        out, captures = self.out, self.seen.groups_of("polariser")
        for group in captures:
            self._common(group, "[[polariser]]")
            if group.first.name.angle is None:
                out.todo("angle_deg", 45.0, "angle of the rotating polariser", group.first.name.path)
            else:
                out.key("angle_deg", group.first.name.angle, "from the file name")
        if captures and self.camera is not None and self.camera.polarisers is not None:
            stated = self.camera.polarisers
            for name, angle, present in zip(self.camera.channels, stated.polariser_deg, stated.present, strict=True):
                if present:
                    out.table(f"[channel.{toml_key(name)}]", polariser_deg=float(angle))

    def _list(self, kind: str, groups: Sequence[Group]) -> None:
        for group in groups:
            single = sum(frame.count for frame in group.frames) < PAIR
            if single:
                self.seen.notes.append(f"{group.first.name.path}: noise cannot be measured from a single {kind} frame")
            self._common(group, f"[[{kind}]]")
            if single:
                self.out.todo("frames", ["a_1.tif", "a_2.tif"], "at least two frames", group.first.name.path)
