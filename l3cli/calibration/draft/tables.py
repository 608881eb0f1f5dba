"""A folder of tables without frames, as published measurements are → the text of a measurement file."""

import re
from collections.abc import Sequence

from l3cli.artifacts.camera import MAX_CHANNELS, CameraModel
from l3cli.calibration.draft.compose import HEAD, PITCH, DraftText, known_body, unknown_optics
from l3cli.calibration.draft.matching import Spectra
from l3cli.calibration.draft.names import read_name
from l3cli.errors import InputFileError
from l3cli.frames.measurement import DIODE
from l3cli.system.text import counted

LIGHT = re.compile(r"light[ _]+(?!diode)(.+)", re.IGNORECASE)  # a sweep's column of a channel
USUAL = {1: ["y"], 3: ["r", "g", "b"]}  # channels of curves without a heading
SENSOR = (
    ("rows", 3000, "of the sensor, by its data sheet"),
    ("cols", 4000, "of the sensor, by its data sheet"),
    ("pixel_pitch_um", 3.45, PITCH),
    ("bits", 12, "of the converter, by its data sheet"),
)
SHEET = (("black_level_dn", 64), ("white_level_dn", 4095), ("well_capacity_e", 10000), ("read_noise_e", 5.0))


def compose_tables(tables: Sequence[Spectra], camera: CameraModel | None, name: str, left_out: Sequence[str]) -> DraftText:
    """Return the draft of a measurement file by the tables of a folder: a sweep with its photodiode, or finished curves.
    Sensor, array and optics are those of `camera`; `left_out`: notes of files that are no tables of spectra. InputFileError
    if no table holds either."""
    out = DraftText()
    sweep = next((table for table in tables if channels_of_sweep(table)), None)
    curves = _finished(tables)
    if sweep is None and not curves:
        raise InputFileError(_nothing(tables))
    used = sweep or curves[0]
    names = channels_of_sweep(used) or (list(used.table.names) if used.table.names else None)
    if camera is None:
        out.assume("name", name, "the folder's name", announced=False)
        _body(out, names, len(used.table.values))
    else:
        out.key("name", camera.name)
        known_body(out, camera)
    if sweep is not None:
        out.table("[sweep]", table=sweep.path)
        _photodiode(out, sweep, tables)
    else:
        out.table("[curves]")
        if left_out:
            files = ", ".join(note.partition(":")[0] for note in left_out)
            out.assume(
                "file", used.path, f"finished curves; if {files} measured them, give a [sweep] of those with wavelengths"
            )
        else:
            out.key("file", used.path)
        for other in curves[1:]:
            out.comment(f"or {other.path}")
        _per_energy(out, used)
    _sheet(out, camera)
    out.comment("", "How well photodiode and wavelengths were known: [uncertainty] (documentation, Measurement files)")
    out.head(HEAD)
    return out


def channels_of_sweep(spectra: Spectra) -> list[str]:
    """Return the channels of a sweep with means of light and dark beside a photodiode, by its heading; none of another
    table."""
    names = spectra.table.names or ()
    channels = [match[1] for name in names if (match := LIGHT.fullmatch(name))]
    diode = any("diode" in DIODE.get(name.casefold(), name).casefold() for name in names)
    return channels if diode and len(names) == 2 * len(channels) + 2 else []


def _finished(tables: Sequence[Spectra]) -> list[Spectra]:
    """Return tables that may be responsivities: neither lines of a monochromator nor patches of a chart; a single column, as
    lamps and photodiodes have, only where there is no other table."""
    broad = [table for table in tables if not table.has_patches and not _has_lines(table)]
    broad = [table for table in broad if len(table.table.values) <= MAX_CHANNELS and table.table.values.max() > 0]
    return [table for table in broad if len(table.table.values) > 1] or (broad if len(tables) == 1 else [])


def _has_lines(spectra: Spectra) -> bool:
    """Return whether the columns are the steps of a monochromator: by wavelengths in the heading, or lines without one."""
    names = spectra.table.names
    return spectra.narrow if names is None else all(read_name(f"{name}.csv").nm is not None for name in names)


def _nothing(tables: Sequence[Spectra]) -> str:
    table = tables[0]
    first, last = table.table.wavelength[[0, -1]]
    more = f" and {len(tables) - 1} more" if len(tables) > 1 else ""
    return (
        f"{table.path} ({counted(len(table.table.values), 'column')}, {first:g}…{last:g} nm){more}: neither a sweep nor "
        "responsivities, and there is no raw frame; add the table with a column for each channel, or the captures"
    )


def _body(out: DraftText, names: list[str] | None, columns: int) -> None:
    """Add [sensor], [cfa] and [optics] of a camera that only its user knows, but for the names of channels."""
    out.table("[sensor]")
    for key, example, what in SENSOR:
        out.todo(key, example, what, "[sensor]")
    out.table("[cfa]")
    if names:
        out.key("channels", names, "as the table's heading names them")
    elif columns in USUAL:
        out.assume("channels", USUAL[columns], "the usual order of columns; the table has no heading")
    else:
        out.todo("channels", ["r", "g", "b"], "names of the channels, in the order of the table's columns", "[cfa]")
    out.todo("pattern", ["r g", "g b"], "rows of names, which repeat over the sensor", "[cfa]")
    unknown_optics(out)


def _photodiode(out: DraftText, sweep: Spectra, tables: Sequence[Spectra]) -> None:
    """Add the table of a photodiode: that of one column that covers the sweep."""
    grid = sweep.table.wavelength
    single = [table for table in tables if table is not sweep and len(table.table.values) == 1]
    single = [table for table in single if table.table.wavelength[0] <= grid[0] and grid[-1] <= table.table.wavelength[-1]]
    if not single:
        out.todo("photodiode", "diode.csv", "response of the photodiode over the whole sweep, such as A/W", "[sweep]")
    elif len(single) == 1:
        out.key("photodiode", single[0].path)
    else:
        others = ", ".join(table.path for table in single[1:])
        out.assume("photodiode", single[0].path, f"one of several tables of one column: also {others}")


def _per_energy(out: DraftText, curves: Spectra) -> None:
    """Add whether curves are per energy or per photon, if their unit says so."""
    possible = [each for each in (True, False) if _has_unit(curves, each)]
    if len(possible) == 1:
        out.key("per_energy", possible[0], "by the unit in the heading")
    elif "%" in curves.table.units:
        out.assume("per_energy", False, "percentages are quantum efficiencies; true: relative, per energy")
    else:
        out.assume("per_energy", True, "relative curves usually are; false: per photon, as quantum efficiencies are")


def _has_unit(curves: Spectra, per_energy: bool) -> bool:
    try:
        curves.table.responses(per_energy, "per_energy")
    except InputFileError:
        return False
    return True


def _sheet(out: DraftText, camera: CameraModel | None) -> None:
    """Add [datasheet], which tables of curves do not replace."""
    if camera is None:
        out.todo_table("[datasheet]", "the sensor's figures: no white and dark frames measure them", *SHEET)
        return
    noise = camera.noise
    out.table(
        "[datasheet]", black_level_dn=camera.black_level, white_level_dn=camera.white_level, gain_dn_per_e=camera.gain,
        well_capacity_e=noise.well_capacity, read_noise_e=noise.read_noise, dark_current_e_per_s=noise.dark_current,
        dsnu_e=noise.dsnu, prnu=noise.prnu, column_noise_e=noise.column_noise,
    )  # fmt: skip
