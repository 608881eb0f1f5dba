"""Format calibration results for reports: EMVA 1288 parameters, errors relative to a true camera, and warnings."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, Polarisers, sensitivity_threshold
from l3cli.artifacts.camera_curves import full_width
from l3cli.artifacts.fit import ChartFit, Fit, NoiseFit, PhotoFit, PolariserFit, SeriesFit, guessed_light
from l3cli.calibration import responsivity
from l3cli.calibration.captures import corner_falloff
from l3cli.calibration.photo.estimate import NOTICED, terms
from l3cli.calibration.responsivity import COVERAGE, likely_mistake
from l3cli.calibration.statistics import defect_counts
from l3cli.errors import InputFileError
from l3cli.frames.super_pixels import FRACTION
from l3cli.physics import spectra
from l3cli.physics.stokes import angle_difference
from l3cli.system.text import columns, figure

SHOWN = 8  # number of defective pixels in the text; JSON and the artifact contain all defective pixels
LEAST_EFFICIENCY = 0.01  # a lower peak quantum efficiency is probably due to a wrong unit
MOST_MISFIT = 0.03  # largest acceptable RMS error of a photo's patches, as a fraction of the brightest patch
LARGEST_POWER = 4  # factors of 10^4 and above are printed as powers of ten
TINY_LEAKAGE = 1e-6  # smaller leakages are replaced by this value, because the extinction ratio of no leakage is infinite
LEAST_R_SQUARED, MOST_RMSE = 0.98, 0.02  # validation limits for each channel; the RMSE is relative to the mean signal


def camera_figures(camera: CameraModel) -> dict[str, tuple[float, str]]:
    """Return a camera's noise parameters and levels, averaged over its channels.

    Returns
    -------
    dict
        Value and unit of each parameter, by its name in EMVA 1288. Row and column noise are included only if they are not
        zero. "row noise" and "column noise" are fixed offsets, which are not part of "DSNU". "PRNU" does not include the
        PRNU of rows and columns.
    """
    noise = camera.noise
    lines = {
        "row temporal noise": (noise.row_temporal_noise, "e-"),
        "column temporal noise": (noise.column_temporal_noise, "e-"),
        "row noise": (noise.row_noise, "e-"),
        "column noise": (noise.column_noise, "e-"),
        "row PRNU": (100.0 * noise.row_prnu, "%"),
        "column PRNU": (100.0 * noise.column_prnu, "%"),
    }
    return {
        "overall system gain K": (camera.gain, "DN/e-"),
        "temporal dark noise": (noise.dark_noise, "e-"),
        "dark current": (noise.dark_current, "e-/s"),
        "DSNU": (noise.dsnu, "e-"),
        "PRNU": (100.0 * noise.prnu, "%"),
        "saturation capacity": (min(noise.well_capacity, camera.full_scale), "e-"),
        "black level": (camera.black_level, "DN"),
        "white level": (camera.white_level, "DN"),
        **{name: entry for name, entry in lines.items() if entry[0]},
    }


def noise_errors(camera: CameraModel) -> dict[str, tuple[float, str]]:
    """Return the 95 % confidence intervals of DSNU, PRNU, row noise and column noise.

    Returns
    -------
    dict
        Half width and unit of each interval, by its name in tables. Noise that is zero or was not measured is omitted.
    """
    fit, noise = camera.fit.noise if camera.fit else None, camera.noise
    if fit is None:
        return {}
    pixel_prnu, prnu_error = fit.pixel_prnu
    errors = {
        "DSNU": (_error_of_mean(camera, noise.dsnu, fit.dsnu, fit.dsnu_error), "e-"),
        "PRNU": (100.0 * _error_of_mean(camera, noise.prnu, pixel_prnu, prnu_error), "%"),
        "row temporal noise": (fit.row_temporal_noise_error if noise.row_temporal_noise else 0.0, "e-"),
        "column temporal noise": (fit.column_temporal_noise_error if noise.column_temporal_noise else 0.0, "e-"),
        "row noise": (fit.row_noise_error if noise.row_noise else 0.0, "e-"),
        "column noise": (fit.column_noise_error if noise.column_noise else 0.0, "e-"),
        "row PRNU": (100.0 * fit.row_prnu_error if noise.row_prnu else 0.0, "%"),
        "column PRNU": (100.0 * fit.column_prnu_error if noise.column_prnu else 0.0, "%"),
    }
    return {f"{name} ±": (COVERAGE * error, unit) for name, (error, unit) in errors.items() if error}


def _error_of_mean(camera: CameraModel, mean: float, deviations: Any, errors: Any) -> float:
    """Return the standard error of `mean`, which is the RMS of the channels' `deviations`, weighted by numbers of pixels.

    `errors` are the standard errors of the deviations. If they are unknown, or if the mean is 0, the result is 0.
    """
    if errors is None or not mean:
        return 0.0
    pixels = np.bincount(camera.cfa.ravel(), minlength=len(camera.channels)) / camera.cfa.size
    return float(np.sqrt(np.sum((pixels * deviations * errors) ** 2)) / mean)


def blinking_figures(camera: CameraModel) -> dict[str, tuple[float, str]]:
    """Return the blinking pixels per million, the number of dark frames, and the median step between the two levels.

    If there were too few dark frames, the result is empty. If no pixel blinks, it contains no step.
    """
    fit = camera.fit.noise if camera.fit else None
    if fit is None or not fit.blinking_frames:
        return {}
    count = 0 if fit.blinking is None else len(fit.blinking)
    found = {
        "blinking pixels": (1e6 * count / (camera.rows * camera.cols), "per million"),
        "dark frames for blinking pixels": (float(fit.blinking_frames), "frames"),
    }
    if fit.blinking_step is not None:
        found["step of blinking pixels"] = (float(np.median(fit.blinking_step)), "e-")
    return found


def figures(camera: CameraModel) -> dict[str, Any]:
    """Return all calibration results as JSON data.

    Returns
    -------
    dict
        Results for the whole camera, and for each channel, illuminant, filter, analog gain and photo. Entries that were not
        measured are empty or None.
    """
    fit = camera.fit or Fit()
    columns: dict[str, Any] = {}
    if fit.chart is not None:
        columns |= _efficiency_columns(camera, fit.chart)
    if fit.noise is not None:
        columns |= _emva_columns(fit.noise)
    if fit.sweep is not None:
        columns["Eq. 1 (% left)"] = 100.0 * fit.sweep.residual
    if fit.series is not None:
        columns["LE (%)"] = 100.0 * fit.series.linearity_error
    if fit.validation is not None:
        columns |= {"R²": fit.validation.r_squared, "RMSE (%)": 100.0 * fit.validation.relative_rmse}
    if fit.photo is not None:
        columns |= _photo_columns(camera, fit.photo)
    if fit.polarisers is not None:
        columns |= _polariser_columns(fit.polarisers)
    if camera.polariser_field is not None:
        columns["pixels (°)"] = pixel_angle_deviation(camera)
    return {
        "camera": {
            name: {"value": value, "unit": unit}
            for name, (value, unit) in (camera_figures(camera) | noise_errors(camera) | blinking_figures(camera)).items()
        },
        "channels": _by_channel(camera, columns) if columns else {},
        "lights": _lights(camera, fit.chart) if fit.chart else {},
        "bands": _bands(camera, fit.series) if fit.series else {},
        "gains": _gains(camera),
        "photos": _photos(fit.photo) if fit.photo else {},
        "prior": fit.photo.prior if fit.photo else None,
        "next light": {"light": fit.photo.next_light, "remaining %": 100.0 * fit.photo.next_share} if fit.photo else None,
        "curves": _curves(camera),
        "lamp drift %": 100.0 * fit.drift.deviation if fit.drift else None,
        "smoothing": fit.sweep.chosen_smoothing if fit.sweep else None,
        "responsivity": "absolute" if camera.absolute else "relative",
        "declared": list(camera.declared),
        "left out": [capture for each in (fit.photo, fit.sweep, fit.series) if each for capture in each.left_out],
        "defects": fit.noise.defects.tolist() if fit.noise else [],
        "defect map": defect_counts(camera.defects, (camera.rows, camera.cols)) if camera.defects else None,
        "corner fall-off %": _corners(camera),
        "saturation reached": bool(fit.noise.white_level_reached) if fit.noise else None,
    }


def _curves(camera: CameraModel) -> dict[str, Any]:
    """Return the wavelength range of the responsivity curves, and each channel's peak wavelength and FWHM.

    The FWHM is None if the curve does not fall below half maximum on both sides.
    """
    grid = camera.wavelength
    channels = {
        name: {"peak (nm)": float(grid[curve.argmax()]), "FWHM (nm)": full_width(grid, curve)}
        for name, curve in zip(camera.channels, camera.responsivity, strict=True)
    }
    return {"first (nm)": float(grid[0]), "last (nm)": float(grid[-1]), "channels": channels}


def _corners(camera: CameraModel) -> dict[str, float] | None:
    """Return each channel's loss of light in the darkest corner, in percent, or None without a flat field."""
    if camera.flat_field is None:
        return None
    lost = 100.0 * corner_falloff(camera.flat_field)
    return {name: float(share) for name, share in zip(camera.channels, lost, strict=True)}


def _efficiency_columns(camera: CameraModel, chart: ChartFit) -> dict[str, Any]:
    """Return each channel's peak quantum efficiency, the half width of its 95 % band (if known), and its offset.

    The offset is beta in Eq. 2 (docs/method.md#gain-and-offset).
    """
    peak = camera.responsivity.argmax(axis=1)[:, None]
    height, band = (np.take_along_axis(of, peak, 1)[:, 0] for of in (camera.responsivity, camera.responsivity_band))
    known = {"± 95 % (%)": 100.0 * band} if camera.responsivity_band.any() else {}
    return {"peak QE (%)": 100.0 * height, **known, "offset (DN)": chart.beta}


def _emva_columns(noise: NoiseFit) -> dict[str, Any]:
    """Return the EMVA 1288 parameters of each channel.

    The dynamic range extends from the absolute sensitivity threshold (SNR = 1) to saturation.
    """
    least = sensitivity_threshold(noise.read_noise, noise.conversion_gain)
    return {
        "K (DN/e-)": noise.conversion_gain,
        "dark noise (e-)": noise.read_noise,
        "dark current (e-/s)": noise.dark_current,
        "DSNU (e-)": noise.dsnu,
        "PRNU (%)": 100.0 * noise.pixel_prnu[0],
        "SNR max (dB)": 10.0 * np.log10(noise.saturation_capacity),
        "DR (dB)": 20.0 * np.log10(noise.saturation_capacity / least),
        "LE (%)": 100.0 * noise.linearity_error,
    }


def _polariser_columns(fit: PolariserFit) -> dict[str, Any]:
    """Return each channel's angle, extinction ratio and relative gain, with 95 % confidence intervals.

    A leakage is at least its standard deviation, so that extinction ratios are finite. A channel without a polariser has an
    extinction ratio of 1.
    """
    leakage = np.maximum(fit.leakage, fit.leakage_error)
    return {
        "polariser (°)": fit.angle,
        "± 95 % (°)": COVERAGE * fit.angle_error,
        "extinction": 1.0 / leakage,
        "extinction ± (%)": 100.0 * COVERAGE * fit.leakage_error / leakage,
        "gain (relative)": fit.gain,
        "gain ± (%)": 100.0 * COVERAGE * fit.gain_error / fit.gain,
    }


def pixel_angle_deviation(camera: CameraModel) -> NDArray[np.float64]:
    """Return the RMS deviation of the pixels' polariser angles from the angle of their channel, (channel,), in degrees."""
    assert camera.polariser_field is not None
    _, first, second = camera.relative_stokes_response.T
    deviation = camera.polariser_field.response_deviation / 2.0**FRACTION
    channel = camera.channel_map(deviation.shape[:2])
    across = first[channel] * deviation[..., 2] - second[channel] * deviation[..., 1]
    turn = across / np.maximum(2.0 * (first**2 + second**2), np.finfo(np.float64).tiny)[channel]
    count = np.bincount(channel.ravel(), minlength=len(camera.channels))
    return np.degrees(np.sqrt(np.bincount(channel.ravel(), turn.ravel() ** 2, len(camera.channels)) / count))


def _lights(camera: CameraModel, chart: ChartFit) -> dict[str, dict[str, float]]:
    """Return each channel's R² and relative RMSE in each chart capture."""
    rows = {}
    for index, light in enumerate(chart.illuminants):
        measured, predicted = chart.measured[index][None], chart.predicted[index][None]
        rmse = 100.0 * responsivity.relative_rmse(measured, predicted, camera.black_level)
        fits = responsivity.r_squared(measured, predicted)
        cells = {f"RMSE {name} (%)": float(value) for name, value in zip(camera.channels, rmse, strict=True)}
        rows[f"{index + 1} {light}"] = cells | {f"R² {n}": float(v) for n, v in zip(camera.channels, fits, strict=True)}
    return rows


def _gains(camera: CameraModel) -> dict[str, dict[str, float]]:
    """Return the noise parameters of the camera at each analog gain."""
    rows = {}
    for times in sorted([1.0, *camera.gains.analog_gain]) if camera.gains else []:
        there = camera.at_gain(float(times))
        capacity, least = there.full_scale, sensitivity_threshold(there.noise.dark_noise, there.gain)
        rows[f"gain {times:.3g}"] = {
            "K (DN/e-)": there.gain,
            "dark noise (e-)": there.noise.dark_noise,
            "capacity (e-)": capacity,
            "SNR max (dB)": float(10.0 * np.log10(capacity)),
            "DR (dB)": float(20.0 * np.log10(capacity / least)),
        }
    return rows


def _bands(camera: CameraModel, series: SeriesFit) -> dict[str, dict[str, float]]:
    """Return each filter's central wavelength, and the mean and spread of each channel's response to it."""
    rows = {}
    for index, light in enumerate(series.lights):
        row = {"centre (nm)": float(camera.wavelength[index])}
        for channel, name in enumerate(camera.channels):
            row[name] = float(series.response[index, channel])
            row[f"± {name} (%)"] = 100.0 * float(series.spread[index, channel])
        rows[light] = row
    return rows


def _photo_columns(camera: CameraModel, fit: PhotoFit) -> dict[str, Any]:
    """Return the uncertainties of the curves, and of colours predicted from the curves under other illuminants."""
    band = camera.responsivity_band / camera.responsivity.max(axis=1, keepdims=True)
    return {
        "curve ± 95 % (% of peak)": 100.0 * np.sqrt(np.mean(band**2, axis=1)),
        "colours ± 95 % (% of most)": 100.0 * fit.response_band,
    }


def _photos(fit: PhotoFit) -> dict[str, dict[str, Any]]:
    """Return each photo's illuminant, chart, illumination unevenness, glare and RMS error."""
    rows = {}
    for index, name in enumerate(fit.names):
        place = np.stack(np.meshgrid(np.linspace(-1, 1, 7), np.linspace(-1, 1, 5)), axis=-1)
        light = terms(place.reshape(-1, 2)) @ fit.illumination[index]
        brightest = np.where(fit.used[index], fit.measured[index], 0.0).max(axis=0)
        rows[name] = {
            "light": fit.lights[index],
            "guessed": bool(fit.guessed[index]),
            "nearest": fit.nearest[index],
            "deficit": float(fit.deficit[index]),
            "probable lights": fit.likely.of(index) if fit.likely else {},
            "chart": fit.charts[index],
            "corners": fit.corners[index].tolist(),
            "uneven %": 100.0 * float(np.ptp(light) / light.max()),
            "glare %": [100.0 * float(share) for share in fit.glare[index] / brightest],
            "misfit %": [100.0 * float(share) for share in fit.misfit[index]],
        }
    return rows


def compare(camera: CameraModel, truth: CameraModel) -> dict[str, Any]:
    """Compare a calibrated camera's parameters and responsivities with those of the true camera.

    Parameters
    ----------
    camera : CameraModel
        Calibrated camera.
    truth : CameraModel
        Camera from which the measurements were simulated.

    Returns
    -------
    dict
        Entry "camera": each parameter's measured value ("recovered"), true value, unit and error. If only one of the cameras
        has row or column noise, the value of the other camera is 0. Entry "channels": errors of the responsivities and, if
        both cameras have polarisers, of the polarisers.

    Raises
    ------
    InputFileError
        If the cameras have different channels.
    """
    if camera.channels != truth.channels:
        raise InputFileError(
            f"the camera in ‹truth› has the channels {' '.join(truth.channels)}, but the measured camera has "
            f"{' '.join(camera.channels)}; set ‹truth› to the camera that was measured"
        )
    real = spectra.average(truth.responsivity, truth.wavelength, camera.wavelength)
    if not camera.absolute:
        real = real / real.max()
    error = camera.responsivity - real
    columns = {"responsivity RMS error (% of peak)": 100.0 * np.sqrt(np.mean(error**2, axis=1)) / real.max(axis=1)}
    if camera.responsivity_band.any():
        columns["within band (%)"] = 100.0 * np.mean(np.abs(error) <= camera.responsivity_band, axis=1)
    if camera.absolute:
        fitted_gain, true_gain = camera.gain * camera.responsivity.sum(axis=1), truth.gain * real.sum(axis=1)
        columns["gain alpha·r error (%)"] = 100.0 * (fitted_gain / true_gain - 1.0)
    if camera.polarisers is not None and truth.polarisers is not None:
        columns |= _polariser_errors(camera.polarisers, truth)
    found, true = camera_figures(camera), camera_figures(truth)
    parameters: dict[str, dict[str, Any]] = {}
    for name, (_, unit) in (found | true).items():
        value, known = (each.get(name, (0.0, unit))[0] for each in (found, true))
        percent = 100.0 * (value / known - 1.0) if known else None
        parameters[name] = {"recovered": value, "true": known, "unit": unit, "error %": percent}
    return {
        "camera": parameters,
        "channels": _by_channel(camera, columns),
    }


def _polariser_errors(measured: Polarisers, truth: CameraModel) -> dict[str, Any]:
    """Return the angle errors in degrees and the extinction ratio errors in percent.

    The true leakage is averaged over wavelength, weighted with the channel's responsivity.
    """
    assert truth.polarisers is not None
    true = (truth.polarisers.leakage * truth.responsivity).sum(axis=1) / truth.responsivity.sum(axis=1)
    found = np.maximum(measured.leakage.mean(axis=1), TINY_LEAKAGE)
    return {
        "polariser error (°)": angle_difference(measured.polariser_deg, truth.polarisers.polariser_deg),
        "extinction error (%)": 100.0 * (np.maximum(true, TINY_LEAKAGE) / found - 1.0),
    }


def _by_channel(camera: CameraModel, columns: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Convert columns of one value per channel to one dict of Python numbers per channel."""
    return {
        name: {title: float(column[index]) for title, column in columns.items()}
        for index, name in enumerate(camera.channels)
    }


def as_text(result: dict[str, Any], width: int | None = None) -> list[str]:
    """Format calibration results as lines of text.

    Parameters
    ----------
    result : dict
        Result of `figures`. If the true camera is known, the entry "truth" contains the result of `compare`.
    width : int, optional
        Largest width in characters. Wider tables are split. If None, the width is not limited.
    """
    truth = result.get("truth")
    lines = []
    missed = {name: known for name, known in truth["camera"].items() if name not in result["camera"]} if truth else {}
    zeros = {name: {"value": 0.0, "unit": known["unit"]} for name, known in missed.items()}
    for name, entry in (result["camera"] | zeros).items():
        line = f"{name:24}{figure(entry['value'], '.5g'):>12} {entry['unit']:6}"
        if truth and name in truth["camera"]:
            known = truth["camera"][name]
            error = "" if known["error %"] is None else f"  error {figure(known['error %'], '+.2f')} %"
            line += f"  true {figure(known['true'], '.5g'):>10}{error}"
        lines.append(line.rstrip())
    for table in (
        result["channels"],
        result["lights"],
        result["bands"],
        result["gains"],
        truth["channels"] if truth else {},
    ):
        lines += ["", *_table(table, width)] if table else []
    lines += _photo_lines(result) if result["photos"] else []
    lines += ["", *matrix_lines(result["matrices"], width)] if result.get("matrices") else []
    lines += ["", f"responsivity: {result['responsivity']}"]
    source = "not measured, assumed to be 0" if "dark current" in result["declared"] else "from the data sheet"
    lines += [f"{source}: {', '.join(result['declared'])}"] if result["declared"] else []
    lines += [f"left out: {capture}" for capture in result["left out"]]
    defects = result["defects"]
    if defects:
        shown = " ".join(f"({row}, {col})" for row, col in defects[:SHOWN]) + (" …" if len(defects) > SHOWN else "")
        lines.append(f"ignored {len(defects)} hot and dead pixels (row, column): {shown}")
    return lines + _correction_lines(result) + _curve_lines(result["curves"], width)


def _curve_lines(curves: dict[str, Any], width: int | None) -> list[str]:
    rows = []
    for name, curve in curves["channels"].items():
        wide = "–" if curve["FWHM (nm)"] is None else f"{curve['FWHM (nm)']:.0f}"
        rows.append([name, f"{curve['peak (nm)']:g}", wide])
    range_nm = f"{curves['first (nm)']:g}…{curves['last (nm)']:g} nm"
    return ["", f"curves, {range_nm}", *columns(["channel\n", "peak\nnm", "FWHM\nnm"], rows, width)]


def _correction_lines(result: dict[str, Any]) -> list[str]:
    lines = []
    if found := result["defect map"]:
        lines.append("defect map: " + ", ".join(f"{what} {count}" for what, count in found.items()))
    if lost := result["corner fall-off %"]:
        shares = ", ".join(f"{name} {figure(share, '.3g')} %" for name, share in lost.items())
        lines.append(f"flat field: loss of light in the darkest corner: {shares}")
    return lines


def matrix_lines(matrices: dict[str, dict[str, dict[str, Any]]], width: int | None = None) -> list[str]:
    """Format the colour errors of the exported matrices as a table with a row for each illuminant and matrix.

    Parameters
    ----------
    matrices : dict
        Statistics of CIEDE2000 errors over measured surfaces, by illuminant and matrix.
    width : int, optional
        Largest width in characters.
    """
    headings = ["light", "matrix", "ΔE00 mean", "95 %", "worst", "of L*", "a*", "b*"]
    rows = [
        [
            light,
            matrix,
            *(figure(each[key], ".2f") for key in ("mean", "95 %", "worst")),
            *(f"{v:.0f}" for v in each["worst L*a*b*"]),
        ]
        for light, kinds in matrices.items()
        for matrix, each in kinds.items()
    ]
    return columns(headings, rows, width)


def _table(rows: dict[str, dict[str, float]], width: int | None) -> list[str]:
    """Format a table with two heading lines: titles, and units from the brackets in the titles."""
    titles = list(next(iter(rows.values())))
    headings = ["channel\n", *("\n".join(title.rstrip(")").partition(" (")[::2]) for title in titles)]
    return columns(headings, [[name, *(figure(row[title], ".5g") for title in titles)] for name, row in rows.items()], width)


def _photo_lines(result: dict[str, Any]) -> list[str]:
    lines = [""]
    for name, photo in result["photos"].items():
        light = guessed_light(photo["probable lights"]) if photo["guessed"] else photo["light"]
        nearest = "" if photo["nearest"] == photo["light"] else f" (most similar common illuminant: {photo['nearest']})"
        lines.append(
            f"{name}: {photo['chart']}, illuminant {light}{nearest}, illumination uneven by {photo['uneven %']:.0f} %, "
            f"glare up to {max(photo['glare %']):.1f} %, RMS error of the patches up to {max(photo['misfit %']):.1f} % "
            "of the brightest patch"
        )
    further = result["next light"]
    return [
        *lines,
        f"prior of the curves: {result['prior']}; colours are less uncertain than curves, as the two bands ± 95 % show",
        f"a further photo under {further['light']} would reduce the colour error to {further['remaining %']:.0f} % of the "
        "present error",
    ]


def doubts(camera: CameraModel) -> list[str]:
    """Return warnings about a calibration that is still usable.

    There are warnings if the lamps drifted more than declared in the measurement file, or if a photo's patches fit another
    illuminant much better than the specified one.
    """
    if camera.fit and camera.fit.drift:
        drift = camera.fit.drift
        return [
            f"the differences between the charts suggest that the lamps drifted by {100 * drift.deviation:.2g} %, which is "
            f'more than the {100 * drift.declared:.2g} % in "uncertainty.lamp_drift"; l3 has widened the confidence bands; '
            'check the exposure times, and to correct a real drift, set "monitor" to the readings of the lamps'
        ]
    fit = camera.fit.photo if camera.fit else None
    if fit is None:
        return []
    return [
        f"{name}: the patches are {_times(fit.deficit[index])} times more probable under {fit.nearest[index]} than under "
        f"the specified illuminant {fit.lights[index]}, which l3 has used; check the illuminant"
        for index, name in enumerate(fit.names)
        if not fit.guessed[index] and fit.deficit[index] > NOTICED
    ]


def _times(logarithm: float) -> str:
    """Format a factor, passed as its natural logarithm, with one significant digit. Large factors become powers of ten."""
    power = logarithm / np.log(10)
    return f"{float(f'{10**power:.1g}'):.0f}" if power < LARGEST_POWER else f"10^{power:.0f}"


def shortfall(camera: CameraModel) -> str | None:
    """Return the reason why a calibration should not be used, or None if it is usable.

    Possible reasons are an implausible monochromatic capture, an implausible quantum efficiency, photo patches that do not
    fit the curves, and a channel that fails the validation.
    """
    if camera.fit and camera.fit.sweep and camera.fit.sweep.odd:
        odd = camera.fit.sweep.odd
        more = f" and {len(odd) - 1} more" if len(odd) > 1 else ""
        return f"{odd[0]}{more}; check the exposure time, the monitor reading and the spectrum"
    peak = float(camera.responsivity.max())
    if camera.absolute and peak < LEAST_EFFICIENCY:
        return f"the peak quantum efficiency is only {100 * peak:.3g} %; {likely_mistake(peak)}"
    if camera.fit and camera.fit.photo and (wrong := _photo_shortfall(camera.fit.photo, camera.channels)):
        return wrong
    validation = camera.fit.validation if camera.fit else None
    if validation is None:
        return None
    for index, name in enumerate(camera.channels):
        fit, rmse = float(validation.r_squared[index]), float(validation.relative_rmse[index])
        if fit < LEAST_R_SQUARED or rmse > MOST_RMSE:
            return (
                f"the validation of channel {name} has R² {fit:.4f} and a relative RMSE of {100 * rmse:.2f} %, but the "
                f"limits are {LEAST_R_SQUARED} and {100 * MOST_RMSE:g} %; check the illuminants and the captures"
            )
    return None


def _photo_shortfall(fit: PhotoFit, channels: tuple[str, ...]) -> str | None:
    """Describe the first photo with patches that do not fit the curves, or return None if all photos fit."""
    for index, name in enumerate(fit.names):
        worst = int(fit.misfit[index].argmax())
        if fit.misfit[index, worst] > MOST_MISFIT:
            return (
                f"{name}: the RMS error of the patches in channel {channels[worst]} is "
                f"{100 * fit.misfit[index, worst]:.1f} % of the brightest patch, but must not exceed {100 * MOST_MISFIT:g} "
                "%; check the type of the chart and the order of its patches"
            )
    return None
