"""Files of a camera for other software: its curves as CSV and as rawtoaces' JSON, a DCP profile as JSON, tuning files of
libcamera, a data sheet as CSV (docs/method.md#colour-matrices). Formats are those of rawtoaces, of dcamprof's json2dcp and
of libcamera's tuning files."""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from l3cli import __version__
from l3cli.artifacts.camera import CameraModel
from l3cli.export.camera_profile import (
    LEAST_CHANNELS,
    TEMPERATURES,
    LightMatrices,
    bayer_order,
    black_level_16,
    datasheet,
    errors,
    light_matrices,
    noise_profile,
    rgb_order,
    temperature_curve,
)
from l3cli.io.curves import curve_text
from l3cli.physics import spectra
from l3cli.system.text import printable

CURVES, RAWTOACES_JSON, DATASHEET = ALWAYS = ("responsivity.csv", "rawtoaces.json", "datasheet.csv")  # of every camera
DCP, RASPBERRY_PI, SIMPLE = "dcp.json", "libcamera_rpi.json", "libcamera_simple.yaml"  # of some

ILLUMINANTS = {"A": "StdA", "D65": "D65"}  # of the two matrices of a DCP, in its order: the colder light second
SIMPLE_DARKEST = 2**15 - 1  # black level that fits the simple pipeline's type
RAWTOACES = np.arange(380.0, 781.0, 5.0)  # nm, the grid of its database
Array = NDArray[np.floating]


def file_names(channels: Sequence[str], cfa: NDArray[np.integer]) -> list[str]:
    """Return the names of the files of cameras of an array."""
    dcp = (DCP,) if len(channels) >= LEAST_CHANNELS else ()
    return [*ALWAYS, *dcp, *((RASPBERRY_PI, SIMPLE) if bayer_order(channels, cfa) else ())]


class Exported(NamedTuple):
    """Files of a camera for other software."""

    files: dict[str, str]  # name → content
    errors: dict[str, dict[str, dict[str, Any]]]  # of its matrices, for each light, ready for JSON
    note: str | None  # on what is left out


def export(camera: CameraModel) -> Exported:
    """Return all files of a camera."""
    camera = replace(camera, name=printable(camera.name))  # that of a file may hold bytes that are no text
    files = {**_curves(camera), DATASHEET: _datasheet_csv(camera)}
    lights = {name: light_matrices(camera, name) for name in TEMPERATURES}
    known = {name: matrices for name, matrices in lights.items() if matrices is not None}
    if missing := [name for name in lights if name not in known]:
        few = len(camera.channels) < LEAST_CHANNELS
        reason = "it has fewer than three channels" if few else f"a channel sees next to nothing of {missing[0]}"
        return Exported(files, {}, f"{camera.name}: no colour matrices and no tuning files: {reason}")
    files[DCP] = _dcp_json(camera, known)
    order, note = bayer_order(camera.channels, camera.cfa), None
    if order is None:
        note = f"{camera.name}: no tuning files for libcamera, which knows 2×2 arrays of r, g and b alone"
    else:
        corrections = {TEMPERATURES[name]: each.correction.values[:, order] for name, each in known.items()}
        curve, noise = temperature_curve(camera, order), noise_profile(camera)
        tuning = Tuning(black_level_16(camera), corrections, curve, noise)
        files |= {RASPBERRY_PI: raspberry_pi_json(camera.name, tuning), SIMPLE: simple_yaml(camera.name, tuning)}
    kinds = {name: ("CCM", "ForwardMatrix", "ColorMatrix") if name in ILLUMINANTS else ("CCM",) for name in known}
    judged = {name: errors(each) for name, each in known.items()}
    return Exported(files, {name: {kind: judged[name][kind] for kind in kinds[name]} for name in known}, note)


def _curves(camera: CameraModel) -> dict[str, str]:
    """Return the responsivities per energy, the peak of the set 1: CSV on their grid, JSON as rawtoaces reads it."""
    curves = camera.responsivity * camera.wavelength
    curves = curves / curves.max()
    table = spectra.average(curves, camera.wavelength, RAWTOACES).T
    manufacturer, _, model = camera.name.partition(" ")
    content: dict[str, Any] = {
        "header": {
            "schema_version": "0.1.0",
            "manufacturer": manufacturer,
            "model": model or manufacturer,
            "description": "camera spectral sensitivity data, relative, per energy",
            "document_creator": "l3 calibrate",
        },
        "spectral_data": {
            "units": "relative",
            "index": {"main": [name.upper() for name in camera.channels]},
            "data": {"main": {f"{nm:g}": row.tolist() for nm, row in zip(RAWTOACES, table, strict=True)}},
        },
    }
    text = json.dumps(content, indent=2, ensure_ascii=False) + "\n"
    return {CURVES: curve_text(camera.wavelength, curves, camera.channels), RAWTOACES_JSON: text}


class Tuning(NamedTuple):
    """Content of libcamera's tuning files for a Bayer camera, its channels in the order r, g, b."""

    black_level: int  # of 16 bits
    corrections: Mapping[int, Array]  # temperature in K, rising → (3, 3)
    curve: Array | None  # (temperature, 3) K, r over g, b over g of a grey
    noise: tuple[float, float]  # constant and slope of a deviation over the root of a signal of 16 bits


def _dcp_json(camera: CameraModel, known: Mapping[str, LightMatrices]) -> str:
    """Return a DCP as dcamprof's json2dcp reads it, for the lights of ILLUMINANTS; beside it the channels in their order,
    that of raw files (r, g, b), and AsShotNeutral, which belongs into the DNG of a picture, for each light."""
    planes = list(rgb_order(camera.channels) or range(len(camera.channels)))
    lights = [known[light] for light in ILLUMINANTS]
    content: dict[str, Any] = {"UniqueCameraModel": camera.name, "ProfileName": "l3", "ProfileEmbedPolicy": "Allow copying"}
    content |= {f"CalibrationIlluminant{i}": code for i, code in enumerate(ILLUMINANTS.values(), 1)}
    content |= {f"ColorMatrix{i}": each.colour.values[planes].tolist() for i, each in enumerate(lights, 1)}
    content |= {f"ForwardMatrix{i}": each.forward.values[:, planes].tolist() for i, each in enumerate(lights, 1)}
    content["Channels"] = [camera.channels[plane] for plane in planes]
    neutrals = (each.neutral[planes].tolist() for each in lights)
    content["AsShotNeutral"] = dict(zip(ILLUMINANTS.values(), neutrals, strict=True))
    return _json(content) + "\n"


def raspberry_pi_json(name: str, tuning: Tuning) -> str:
    """Return a tuning file of libcamera's Raspberry Pi pipelines, version 2.0: JSON, as they name theirs SENSOR.json, and as
    picamera2 reads it; libcamera's YAML reader takes it, too."""
    flat = {"priors": [{"lux": 0, "prior": [2000, 0.0, 13000, 0.0]}]}  # without a lux meter no temperature is likelier
    awb: dict[str, Any] = {"bayes": 0}
    if tuning.curve is not None:
        low, high = int(tuning.curve[0, 0]), int(tuning.curve[-1, 0])
        awb = {**flat, "modes": {"auto": {"lo": low, "hi": high}}, "bayes": 1, "ct_curve": tuning.curve.ravel().tolist()}
    ccms = [{"ct": ct, "ccm": matrix.ravel().tolist()} for ct, matrix in tuning.corrections.items()]
    algorithms = {
        "rpi.black_level": {"black_level": tuning.black_level},
        "rpi.noise": {"reference_constant": tuning.noise[0], "reference_slope": tuning.noise[1]},
        "rpi.awb": awb,
        "rpi.ccm": {"ccms": ccms},
    }
    content = {
        "version": 2.0,
        "target": "bcm2835",
        "comment": _comments(name, tuning),  # libcamera reads version, target and algorithms alone
        "algorithms": [{key: value} for key, value in algorithms.items()],
    }
    return _json(content) + "\n"


def _comments(name: str, tuning: Tuning) -> list[str]:
    """Return the notes for whoever installs the Raspberry Pi file."""
    missing = [] if tuning.curve is not None else ["rpi.awb ct_curve: the channels of greys do not follow a temperature"]
    return [
        f"{name}, l3cli {__version__}: black level, noise, white balance and colours of the camera model",
        "noise: at the analogue gain of the calibration, which counts as 1",
        'a Raspberry Pi 5: "target": "pisp"',
        "missing, take them from the tuning file of a similar sensor: rpi.agc, rpi.contrast, rpi.alsc, rpi.sharpen",
        "missing: rpi.lux, since no scene of known illuminance was measured through the lens; priors are flat without it",
        *(f"missing: {each}" for each in missing),
    ]


def simple_yaml(name: str, tuning: Tuning) -> str:
    """Return a tuning file of libcamera's simple pipeline, the software ISP of laptops and phones, which looks for
    SENSOR.yaml."""
    known = tuning.black_level <= SIMPLE_DARKEST
    lines = [
        "# " + json.dumps(f"{name}, l3cli {__version__}")[1:-1],
        "%YAML 1.1",
        "---",
        "version: 1",
        "algorithms:",
        *(["  - BlackLevel:", f"      blackLevel: {tuning.black_level}"] if known else ["  - BlackLevel:"]),
        "  - Awb:",
        "  - Ccm:",
        "      ccms:",
    ]
    for ct, matrix in tuning.corrections.items():
        rows = [", ".join(f"{value:.6f}" for value in row) for row in matrix]
        lines += [f"        - ct: {ct}", f"          ccm: [ {rows[0]},", f"                 {rows[1]},"]
        lines.append(f"                 {rows[2]} ]")
    return "\n".join([*lines, "  - Adjust:  # older versions of libcamera call it Lut", "  - Agc:", "..."]) + "\n"


def _datasheet_csv(camera: CameraModel) -> str:
    """Return quantity, channel, value, unit and source of every row of the data sheet, under their headings."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for row in (("quantity", "channel", "value", "unit", "source"), *datasheet(camera)):
        writer.writerow([f"{cell:.8g}" if not isinstance(cell, str) else cell for cell in row])
    return text.getvalue()


def _json(value: Any, indent: int = 0) -> str:
    """JSON, two spaces a level, with lists of plain values on one line; ASCII."""
    inner = " " * (indent + 2)
    if isinstance(value, dict):
        lines = [f"{inner}{json.dumps(key)}: {_json(each, indent + 2)}" for key, each in value.items()]
        return "{\n" + ",\n".join(lines) + "\n" + " " * indent + "}"
    if isinstance(value, list) and any(isinstance(each, dict | list | str) for each in value):
        return "[\n" + ",\n".join(inner + _json(each, indent + 2) for each in value) + "\n" + " " * indent + "]"
    return json.dumps(value)
