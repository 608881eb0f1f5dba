"""A camera as its raw files show it: by the chart in one of them, by their colour matrices, or as cameras usually are."""

from collections.abc import Sequence
from pathlib import Path

from l3cli.artifacts.camera import CameraModel
from l3cli.calibration import acceptance, model
from l3cli.calibration.photo import matrices
from l3cli.calibration.photo.matrices import ColourMatrix
from l3cli.errors import InputFileError
from l3cli.frames.measurement import Measurements
from l3cli.io.curves import shipped_statistics
from l3cli.io.measurements import photo_measurements
from l3cli.io.raw.cfa_codes import code_of
from l3cli.io.raw.libraw import Stated
from l3cli.stages.photo_recipe import PhotoCamera, SensorNoise, noise_of
from l3cli.system.console import Console

SEARCHED = 4  # photos of a camera that a chart is looked for in
Taken = Sequence[tuple[Path, Stated]]  # the raw files of a camera, and what each states of it


def photographed(taken: Taken, light: str | None, console: Console) -> PhotoCamera:
    """The camera that took these raw files. `light`: of the charts in them; None: guessed. InputFileError if the first is
    none that states its array and levels, or if nothing tells its curves."""
    path, known = taken[0]
    measured = _measurements(path, light)
    frame = measured.photos[0].frames[0]
    noise = noise_of(known, frame.white_level - frame.black_level)
    for other, _ in taken[:SEARCHED]:
        found = _by_chart(measured if other == path else _measurements(other, light), console)
        if found is None or found.channels != measured.body.channels:
            continue
        assert found.fit is not None
        assert found.fit.photo is not None
        fit = found.fit.photo
        light_of = f"{fit.lights[0]}{' (guessed)' if fit.guessed[0] else ''}"
        origin = f"of the {fit.charts[0]} ColorChecker in {other.name}, under {light_of}"
        if known.noise is None:
            noise = SensorNoise(found.gain, found.noise.read_noise, "as the patches of the chart show it")
        curves = found.responsivity / found.responsivity.max()
        return PhotoCamera(other, measured.body, frame, known, found.wavelength, curves, origin, noise, fit.lights[0])
    curves, origin = _without_chart(path, known, measured)
    return PhotoCamera(path, measured.body, frame, known, curves.wavelength, curves.relative, origin, noise)


def _measurements(path: Path, light: str | None) -> Measurements:
    try:
        return photo_measurements([path], light)
    except InputFileError as error:
        reason, other_cure, _ = str(error).partition("; write a measurement file")
        cure = '; start from a recipe instead, such as "l3 init bayer DIR"' if other_cure else ""
        raise InputFileError(reason + cure) from error


def _by_chart(measured: Measurements, console: Console) -> CameraModel | None:
    """The camera by the chart in its photo; None if there is none, or none to rely on."""
    try:
        camera = model.calibrate(measured)
    except InputFileError:
        return None
    wrong = acceptance.shortfall(camera)
    if wrong:
        console.warn(f"no chart is taken: {wrong}")
    return None if wrong else camera


def _without_chart(path: Path, known: Stated, measured: Measurements) -> tuple[matrices.Curves, str]:
    """The curves by the colour matrices of a file, or the usual ones, and where they are from."""
    channels = measured.body.channels
    prior = matrices.prior_of(channels, shipped_statistics())
    codes = [code_of(name) for name in channels]
    chosen = [each for each in known.matrices if set(codes) <= each.rows.keys()]
    if chosen:
        stated = [ColourMatrix(each.light, each.of(codes)) for each in chosen]
        lights = " and ".join(f"{each.light}{' (assumed)' if each.assumed else ''}" for each in chosen)
        what = "the colour matrices" if len(chosen) > 1 else "the colour matrix"
        return matrices.curves_of_matrices(stated, prior), f"of {what} for {lights}; a photo of a ColorChecker tells more"
    if prior.measured:
        return matrices.usual_curves(prior), "assumed: the mean of 52 measured cameras, for the file states no colour matrix"
    raise InputFileError(
        f"{path} shows no chart and states no colour matrix, so nothing tells the curves of {', '.join(channels)}; "
        'photograph a ColorChecker, or start from curves, "l3 init from_curves DIR"'
    )
