"""Facts about its camera that a raw file states beside the frame: names, colour matrices, noise, lens (DNG 1.7, Exif,
LibRaw)."""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.io.isolated import isolated
from l3cli.io.raw.cfa_codes import codes_of
from l3cli.io.raw.libraw import opened
from l3cli.io.tags import BROKEN, COLOUR_FILTER_ARRAY, exif_of, number, numbers
from l3cli.system.files import require_regular

LIGHTS = {  # values of Exif's LightSource, which DNG calls calibration illuminants → names of lights
    1: "D55", 2: "F2", 3: "A", 4: "D55", 9: "D55", 10: "D65", 11: "D75", 12: "F1", 13: "F3", 14: "F2", 15: "F3", 17: "A",
    18: "B", 19: "C", 20: "D55", 21: "D65", 22: "D75", 23: "D50", 24: "3200K",
}  # fmt: skip
USUAL_LIGHT = "D65"  # of a matrix without one, as of those in LibRaw
UNITS_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # of Exif's FocalPlaneResolutionUnit
PITCHES_UM = 0.5, 50.0  # that are believed
LONGEST = 60  # letters of a name


@dataclass(frozen=True)
class StatedMatrix:
    """From XYZ of a surface under a light to what the camera collects."""

    light: str  # its name
    assumed: bool  # whether the file does not name it
    rows: dict[int, NDArray[np.float64]]  # colour code → (3) its row

    def of(self, codes: Sequence[int | None]) -> NDArray[np.float64]:
        """Return the rows (channel, 3) of these colours."""
        return np.array([self.rows[code] for code in codes if code is not None])


@dataclass(frozen=True)
class Stated:
    """Facts that a raw file states about its camera; None and "" where it does not."""

    camera: str  # make and model
    matrices: tuple[StatedMatrix, ...]
    noise: tuple[float, float] | None  # variance = slope · signal + constant, as shares of full scale above black
    iso: float | None
    pitch_um: float | None
    focal_length_mm: float | None
    f_number: float | None


def stated(path: Path) -> Stated:
    """Return the facts stated by the file in `path`; a wrong statement of its tags counts as none. InputFileError if it
    is no raw file that can be opened."""
    require_regular(path, "give a raw file")
    names, figures, matrices = _stated(path)
    found = tuple(
        StatedMatrix(LIGHTS.get(int(light), USUAL_LIGHT), int(light) not in LIGHTS, rows)
        for light, codes, values in matrices
        if (rows := _rows(codes, values))
    )
    slope, constant = figures.get("noise_slope"), figures.get("noise_constant")
    noise = (slope, constant) if slope and constant is not None and 0 < slope < 1 and 0 <= constant < 1 else None
    pitch = _positive(figures.get("pitch_um"))
    return Stated(
        camera=_named(names),
        matrices=found,
        noise=noise,
        iso=_positive(figures.get("iso")),
        pitch_um=pitch if pitch and PITCHES_UM[0] <= pitch <= PITCHES_UM[1] else None,
        focal_length_mm=_positive(figures.get("focal_length_mm")),
        f_number=_positive(figures.get("f_number")),
    )


def _rows(codes: NDArray, values: NDArray) -> dict[int, NDArray[np.float64]]:
    """Return the rows of a matrix by their colour's code, of several of one code the first; nothing of one that says
    nothing."""
    values = np.asarray(values, np.float64)
    if values.size != 3 * len(codes) or not np.isfinite(values).all() or not values.any(axis=-1).all():
        return {}
    rows: dict[int, NDArray[np.float64]] = {}
    for code, row in zip(codes.tolist(), values.reshape(-1, 3), strict=True):
        rows.setdefault(int(code), row)
    return rows


def _named(names: list[str]) -> str:
    """Make and model as one name, the make once: "Canon", "Canon EOS 550D" → "Canon EOS 550D"."""
    make, model = (" ".join("".join(c if c.isprintable() else " " for c in name).split())[:LONGEST] for name in names)
    return model if model.lower().startswith(make.lower()) else f"{make} {model}".strip()


def _positive(value: float | None) -> float | None:
    return value if value is not None and 0 < value < 1e6 else None


# ------------------------------------------------------------------------------------- in the process that decodes


@isolated("rawpy", "tifffile")
def _stated(path: Path) -> tuple[list[str], dict[str, float], list[tuple[int, NDArray, NDArray]]]:
    """Make and model, numbers by name, matrices with the codes of their light and rows."""
    names, figures, matrices = _facts_of_tags(path)
    with opened(path) as raw:
        if not matrices:
            letters = raw.color_desc.decode("ascii", "replace")[: raw.num_colors]
            values = np.array(raw.rgb_xyz_matrix, np.float64)[: len(letters)]
            matrices = [(0, codes_of(letters), values)] if values.any() else []
        shot = getattr(raw, "other", None)  # rawpy has it since 0.26
        known = {"iso": "iso_speed", "focal_length_mm": "focal_length", "f_number": "aperture"}
        if not getattr(shot, "focal_length", 0.0):
            del known["f_number"]  # LibRaw says 1 where the file says nothing
        figures = {name: float(getattr(shot, key, 0.0)) for name, key in known.items()} | figures
    return names, figures, matrices


def _facts_of_tags(path: Path) -> tuple[list[str], dict[str, float], list[tuple[int, NDArray, NDArray]]]:
    """Return the facts stated by the tags of a TIFF or DNG; none of other files."""
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            first = file.pages[0]
            pages = [first, *(first.pages or ())]
            return [str(first.tags.valueof(tag) or "") for tag in ("Make", "Model")], _figures(pages), _matrices(pages)
    except Exception:  # LibRaw says what is wrong with a file; tags that nobody needs are no reason to refuse it
        return ["", ""], {}, []


def _figures(pages: list[Any]) -> dict[str, float]:
    tags, exif = pages[0].tags, exif_of(pages[0])
    stated = {
        "iso": exif.get("ISOSpeedRatings"),
        "focal_length_mm": tags.valueof("FocalLength") or exif.get("FocalLength"),
        "f_number": tags.valueof("FNumber") or exif.get("FNumber"),
    }
    found = {name: figure for name, value in stated.items() if (figure := number(value))}
    per_unit, unit = number(exif.get("FocalPlaneXResolution")), exif.get("FocalPlaneResolutionUnit", 2)
    if per_unit and unit in UNITS_MM:
        found["pitch_um"] = 1000.0 * UNITS_MM[unit] / per_unit
    profile = next((page.tags.valueof("NoiseProfile") for page in pages if "NoiseProfile" in page.tags), None)
    if profile is not None:
        slope, constant = np.asarray(profile, np.float64).reshape(-1, 2).mean(axis=0).tolist()
        found |= {"noise_slope": slope, "noise_constant": constant}
    return found


def _matrices(pages: list[Any]) -> list[tuple[int, NDArray, NDArray]]:
    """Return XYZ → what the camera collects: AnalogBalance · CameraCalibration · ColorMatrix."""
    tags = pages[0].tags
    raw = [page for page in pages if page.tags.valueof("PhotometricInterpretation") == COLOUR_FILTER_ARRAY]
    codes = np.array(numbers((raw or pages)[0], "CFAPlaneColor", (0, 1, 2)), np.int64)
    count, found = len(codes), []
    for index in (1, 2):
        if f"ColorMatrix{index}" not in tags:
            continue
        with contextlib.suppress(*BROKEN):  # one that is wrong counts as none
            balance = numbers(pages[0], "AnalogBalance", np.ones(count))
            calibration = np.reshape(numbers(pages[0], f"CameraCalibration{index}", np.eye(count)), (count, count))
            matrix = np.reshape(numbers(pages[0], f"ColorMatrix{index}", ()), (count, 3))
            light = int(tags.valueof(f"CalibrationIlluminant{index}") or 0)
            found.append((light, codes, np.array(balance)[:, None] * (calibration @ matrix)))
    return found
