"""The figures of a camera model as the rows of a data sheet: quantity, channel, value, unit, where it comes from."""

import numpy as np

from l3cli.artifacts.camera import CameraModel
from l3cli.calibration.figures import camera_figures

DECLARED_AS = {  # figure: what calibration calls it where it did not measure it
    "overall system gain K": "gain",
    "temporal dark noise": "noise",
    "saturation capacity": "noise",
    "black level": "black level",
    "white level": "white level",
}
NOISE = ("dark current", "DSNU", "PRNU")
Row = tuple[str, str, float | str, str, str]


def datasheet(camera: CameraModel) -> list[Row]:
    """Return the rows of a camera, then of each of its channels; the channel is empty where a row holds for all, the source
    one of "measured", "declared", "recipe"."""
    optics, source = camera.optics, "recipe" if camera.fit is None else "measured"
    given = "recipe" if camera.fit is None else "declared"
    cfa = "/".join(" ".join(camera.channels[channel] for channel in row) for row in camera.cfa)
    rows: list[Row] = [
        ("camera", "", camera.name, "", given),
        ("rows", "", camera.rows, "pixel", given),
        ("columns", "", camera.cols, "pixel", given),
        ("colour filter array", "", cfa, "", given),
        ("pixel pitch", "", 1e6 * camera.pixel_pitch, "um", given),
        ("bits", "", camera.bits, "bit", given),
        ("focal length", "", 1e3 * optics.focal_length, "mm", given),
        ("f-number", "", optics.f_number, "1", given),
    ]
    rows += [
        (name, "", value, unit, given if _declared(name, camera) else source)
        for name, (value, unit) in camera_figures(camera).items()
    ]
    rows.append(("column noise", "", camera.noise.column_noise, "e-", given))
    peaks, unit = camera.responsivity.argmax(axis=1), "e-/photon" if camera.absolute else "relative"
    for index, (channel, peak) in enumerate(zip(camera.channels, peaks, strict=True)):
        height, band = camera.responsivity[index, peak], camera.responsivity_band[index, peak]
        rows.append(("peak responsivity", channel, float(height), unit, source))
        rows += [("95 % band at the peak", channel, float(band), unit, source)] if band else []
        rows.append(("peak wavelength", channel, float(camera.wavelength[peak]), "nm", source))
    share = np.bincount(camera.cfa.ravel(), minlength=len(camera.channels)) / camera.cfa.size
    rows += [("share of the pixels", n, 100 * float(s), "%", given) for n, s in zip(camera.channels, share, strict=True)]
    return rows


def _declared(name: str, camera: CameraModel) -> bool:
    """Return whether calibration took a figure from a data sheet, or as 0."""
    known = DECLARED_AS.get(name, name)
    return known in camera.declared or (name in NOISE and "noise" in camera.declared)
