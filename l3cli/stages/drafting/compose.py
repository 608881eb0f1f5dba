"""Text of a measurement file from the survey of a folder."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from l3cli.artifacts.camera import CameraModel
from l3cli.calibration.draft import sorting
from l3cli.calibration.draft.matching import (
    columns_of,
    match_charts,
    match_light,
    match_steps,
    note_unused,
    radiances,
    unknown_unit,
)
from l3cli.calibration.draft.sorting import Group
from l3cli.calibration.draft.text import DraftText
from l3cli.errors import listed
from l3cli.io.captures import read_capture
from l3cli.recipes.toml import toml_value
from l3cli.spectra.table import CurveTable
from l3cli.spectra.units import PHOTON_RADIANCE, POWER_RADIANCE
from l3cli.stages.drafting.body import describe_camera
from l3cli.stages.drafting.survey import Survey

HEAD = "Draft: complete the lines marked TODO, check those marked ASSUMED, then run l3 calibrate on this file."
LAMP = (
    "Where a lamp was read during captures: monitor = its reading over that when its spectrum was measured (else 1.0).",
    "How well lights were known, at the end of the file: [uncertainty] lamp_drift = 0.01 (relative), wavelength_nm = 0.1",
)
LEAST_CHARTS = 2  # that separate gain from light
CORNERS = [[10, 10], [240, 10], [240, 170], [10, 170]]  # an example
SHARING = ("[[mono]]", "[[band]]")  # whose captures have [common]
SEVERAL = 2  # captures that lack the same from which on [common] has it
EXAMPLE_SPECTRUM = "spectra/mono.csv"
PAIR = 2  # frames that noise is measured on


def compose(seen: Survey, camera: CameraModel | None, name: str, folder: str) -> DraftText:
    """Return the draft of everything in a folder, whose frames' names begin with `folder`."""
    return _Composer(seen, camera, folder).text(name)


class _Composer:
    def __init__(self, seen: Survey, camera: CameraModel | None, folder: str) -> None:
        self.seen, self.camera, self.folder = seen, camera, folder
        self.out = DraftText()
        self.shared: set[str] = set()  # keys that [common] or the first capture explains for all steps or bands
        self.steps, self.bands = seen.groups_of("mono"), seen.groups_of("band")
        self.charts = seen.groups_of("chart", "structured")
        self.whites, self.darks = seen.groups_of("white"), seen.groups_of("dark")
        if self.steps and self.bands:  # one source of responsivity; narrow light on an even field is the better one
            seen.notes.append(f"{len(self.bands)} captures of a chart in narrow bands beside monochromatic ones: left out")
            self.bands = []

    def text(self, name: str) -> DraftText:
        """Return everything, in the order of a measurement file."""
        out = self.out
        if self.camera is not None:
            out.key("name", self.camera.name)
        else:
            out.assume("name", name, "the folder's name", said=False)
        corners = self._chart_corners()
        describe_camera(out, self.seen, self.camera, photo=not self.steps and not self.bands and bool(self.charts))
        if self.steps:
            self._mono()
        elif self.bands:
            self._bands()
        if self.charts:
            self._charts(corners) if self.steps else self._photos(corners) if not self.bands else None
        if self.bands:
            self._datasheet()
        if not self.steps and not self.bands and not self.charts:
            what = "no source of responsivity: monochromatic captures, a chart, or finished curves"
            out.todo_table("[curves]", what, ("file", "curves.csv"), ("per_energy", True))
        self._sensor_frames()
        unused = [table.name.path for table in self.seen.tables if toml_value(table.path) not in str(out)]
        if unused:
            self.seen.notes.append(f"tables of spectra that nothing refers to: {listed(unused)}")
        out.head(HEAD, *self.seen.notes)
        return out

    # -------------------------------------------------------------------------------------------------- captures

    def _common(self, group: Group, heading: str) -> None:
        """Add frames and exposure time of a capture."""
        out, first = self.out, group.first
        out.table(heading)
        out.key("frames", [self._named(frame.name.path) for frame in group.frames])
        if first.seconds is None and "exposure_s" in self.shared and heading in SHARING:
            return
        if first.seconds is None:
            out.todo("exposure_s", 0.01, "s; neither the file nor its name states the exposure time", first.name.path)
        else:
            out.key("exposure_s", float(f"{first.seconds:.6g}"), "by its name" if first.by_name else "")

    def _named(self, path: str) -> str:
        return path if self.folder == "." else f"{self.folder}/{path}"

    def _mono(self) -> None:
        out, seen = self.out, self.seen
        columns = columns_of(seen.tables)
        matched = match_steps(self.steps, columns, seen.scale, seen.notes)
        units = [each.spectra.path for each in matched if each and unknown_unit(each.spectra.table, each.number - 1)]
        self._share(self.steps, units, POWER_RADIANCE)
        out.comment("", *LAMP)
        for number, (step, column) in enumerate(zip(self.steps, matched, strict=True), 1):
            self._common(step, "[[mono]]")
            uneven = step.first.summary.unevenness(float(seen.scale.black.mean()))
            if uneven > 4 * sorting.DIM and not seen.scale.clipped(step):
                out.comment(f"the light is uneven by {uneven:.0%}: a [[mono]] frame is an even field")
            if not columns and len(matched) >= SEVERAL:
                self._wanted_spectrum(number, step)
                continue
            if column is None:
                out.todo("spectrum", "spectra/mono.csv", "measured radiance of this light", step.first.name.path)
                continue
            out.key("spectrum", column.spectra.path)
            how = "" if step.first.name.nm is not None else f"ASSUMED: in order, {column.nm:g} nm"
            out.key("column", column.key, how)
            self._unit(column.spectra.table, column.number - 1)
        note_unused(columns, matched, seen.notes)

    def _share(self, groups: Sequence[Group], unitless: Sequence[str], unit: str) -> None:
        """Add [common]: what several captures lack, once for all of them."""
        out, untimed = self.out, [group for group in groups if group.first.seconds is None]
        if len(untimed) < SEVERAL and len(unitless) < SEVERAL:
            return
        out.table("[common]")
        if len(untimed) >= SEVERAL:
            self.shared.add("exposure_s")
            what = f"s, of {len(untimed)} captures; those that differ have an exposure_s of their own"
            out.todo("exposure_s", 0.01, what, untimed[0].first.name.path)
        if len(unitless) >= SEVERAL:
            self.shared.add("unit")
            what = f"of the radiances of {len(unitless)} captures, where the heading states none"
            out.todo("unit", unit, what, unitless[0])

    def _wanted_spectrum(self, number: int, step: Group) -> None:
        """Add the spectrum of a step as a column of a table that is still to be made."""
        nm, what = (
            step.first.name.nm,
            "make this table of the measured radiance of every [[mono]], a column each, or name yours",
        )
        self._wanted("spectrum", EXAMPLE_SPECTRUM, what, step.first.name.path)
        self.out.key("column", number if nm is None else f"{nm:g}nm")

    def _wanted(self, key: str, example: str, what: str, where: str) -> None:
        """Add a table that is still to be made; the first capture that lacks one says what it holds."""
        if key in self.shared:
            self.out.key(key, example, "as above")
        else:
            self.out.fill(key, example, what, where)
            self.shared.add(key)

    def _unit(self, table: CurveTable, column: int | None) -> None:
        """Add the unit of radiances, where their heading states none."""
        if unknown_unit(table, column) and (column is None or "unit" not in self.shared):
            where, peak = table.path.name, radiances(table, column).max()
            self.out.todo("unit", POWER_RADIANCE, f"its heading states none, it peaks at {peak:.3g}", where)
        elif not any(table.units) and not unknown_unit(table, column):
            self.out.assume("unit", PHOTON_RADIANCE, "the heading states none; it is as large as such radiances are", False)

    def _chart_corners(self) -> dict[int, sorting.Corners]:
        """Return the corners of each chart by the identity of its capture; captures that show something else are left
        out."""
        seen, found = self.seen, dict[int, sorting.Corners]()
        for group in list(self.charts):
            corners = sorting.find_corners(self._mosaic(group.first.name.path) - self._black, seen.period)
            if corners is not None:
                found[id(group)] = corners
            elif group.kind == "structured":
                self.charts.remove(group)
                seen.notes.append(f"{group.first.name.path}: neither even nor a chart that is found; left out")
        return found

    @property
    def _black(self) -> float:
        return self.seen.black_level if self.seen.black_level is not None else float(self.seen.scale.black.mean())

    def _mosaic(self, path: str) -> Any:
        return read_capture(self.seen.listing.folder / path).values.astype(np.float64)

    def _corners(self, corners: sorting.Corners | None, path: str, optional: bool = False) -> None:
        what = "col, row of the outer corners of patches 1, 6, 24, 19; no chart was found"
        if corners is not None:
            self.out.key("corners", corners, "found")
        elif not optional:
            self.out.todo("corners", CORNERS, what, path)

    def _charts(self, corners: dict[int, sorting.Corners]) -> None:
        """Add [[chart]] captures beside a monochromator."""
        out, seen = self.out, self.seen
        tables = match_charts(self.charts, seen.tables, seen.notes)
        for number, (group, table) in enumerate(zip(self.charts, tables, strict=True), 1):
            path = group.first.name.path
            self._common(group, "[[chart]]")
            light = group.first.name.light or (table.name.light if table else None)
            if light:
                out.key("illuminant", light)
            else:
                out.assume("illuminant", f"light {number}", "a name for reports", said=False)
            self._corners(corners.get(id(group)), path)
            if table is None:
                example = f"spectra/chart_{light or number}.csv"
                out.todo("radiance", example, "CSV of the measured radiance of every patch, a column each", path)
            else:
                out.key(
                    "radiance", table.path, "" if table.name.light and table.name.light == light else "ASSUMED: in order"
                )
                self._unit(table.table, None)

    def _bands(self) -> None:
        """Add [[band]] captures: a chart behind narrow filters."""
        out, seen = self.out, self.seen
        corners = sorting.corners_of_series(self.bands, seen.scale, seen.period, self._mosaic)
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
            else:
                what = "make a table for each band, light times reflectance, a column for each of 24 patches, or name yours"
                self._wanted("radiance", f"spectra/{nm:g}nm.csv", what, path)
                if "unit" not in self.shared:
                    out.todo("unit", "relative power", "of these radiances, where the heading states none", path)

    def _photos(self, corners: dict[int, sorting.Corners]) -> None:
        """Add [[photo]]: charts alone."""
        out, seen = self.out, self.seen
        for group in self.charts:
            path = group.first.name.path
            out.table("[[photo]]")
            out.key("frames", [self._named(frame.name.path) for frame in group.frames])
            light, (measured, named) = group.first.name.light, match_light(group, seen.tables)
            if measured is not None and named:
                out.key("light", measured.path)
            elif measured is not None:
                out.assume("light", measured.path, "the only measured light in the folder")
            elif light:
                out.assume("light", light, "by its name")
            else:
                out.comment('light = "D65"  or "3200K", or a CSV of its spectrum; without it, it is guessed')
            self._corners(corners.get(id(group)), path)
            same = [dark for dark in self.darks if dark.first.seconds == group.first.seconds]
            if same and not self._measured_sensor:
                out.key("dark", [self._named(frame.name.path) for frame in same[0].frames])
            elif seen.black_level is None and not same:
                out.todo("dark", ["dark.tif"], "frames without light, same exposure: no file states black", path)

    # ---------------------------------------------------------------------------------------------------- sensor

    @property
    def _measured_sensor(self) -> bool:
        """Return whether there are white frames and dark ones to measure the sensor by."""
        return bool(self.whites) and bool(self.darks)

    def _sensor_frames(self) -> None:
        out, mono = self.out, bool(self.steps)
        if mono and len(self.charts) < LEAST_CHARTS:
            what = f"charts under {LEAST_CHARTS} lights or more give the scale; found: {len(self.charts)}"
            common = (("frames", ["chart_A.tif"]), ("exposure_s", 0.01), ("illuminant", "A"))
            out.todo_table("[[chart]]", what, *common, ("corners", CORNERS), ("radiance", "chart_A.csv"))
        if self.bands:
            self._list("dark", self.darks)
            return
        if self.charts and not mono and not self._measured_sensor:
            return  # photos do without
        self._list("white", self.whites)
        self._list("dark", self.darks)
        example = (("frames", ["a_1.tif", "a_2.tif"]), ("exposure_s", 0.01))
        if not self.whites:
            out.todo_table("[[white]]", "even light at several exposures up to saturation, two frames each", *example)
        if not self.darks:
            out.todo_table("[[dark]]", "no light, at two exposures or more, two frames each", *example)

    def _list(self, kind: str, groups: Sequence[Group]) -> None:
        for group in groups:
            if len(group.frames) < PAIR:
                self.seen.notes.append(f"{group.first.name.path}: a single {kind} frame, from which no noise is measured")
            self._common(group, f"[[{kind}]]")
            if len(group.frames) < PAIR:
                self.out.todo("frames", ["a_1.tif", "a_2.tif"], "two frames or more", group.first.name.path)

    def _datasheet(self) -> None:
        top = self.seen.top
        self.out.todo_table(
            "[datasheet]", "the sensor's figures: bands do not measure it",
            ("black_level_dn", round(self._black)), ("white_level_dn", top), ("well_capacity_e", 10000),
            ("read_noise_e", 5.0),
        )  # fmt: skip
