"""Reliability of a calibrated camera: what its captures, its efficiency and its validation say against it."""

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.fit import PhotoFit
from l3cli.calibration.curves import likely_mistake
from l3cli.calibration.photo.lights import NOTICED

LEAST_EFFICIENCY = 0.01  # at the peak: below, a unit is more likely than such a camera
MOST_MISFIT = 0.03  # of the brightest patch: RMS over the patches of a photo
LEAST_R_SQUARED, MOST_RMSE = 0.98, 0.02  # of every channel, or the calibration has failed


def shortfall(camera: CameraModel) -> str | None:
    """Return the reason not to trust a camera: a sentence that names captures that disagree, an efficiency that is hardly a
    camera's, or the channel that its validation fails; or None."""
    if camera.fit and camera.fit.sweep and camera.fit.sweep.odd:
        odd = camera.fit.sweep.odd
        more = f" and {len(odd) - 1} more" if len(odd) > 1 else ""
        return f"{odd[0]}{more}; check exposure, monitor and spectrum"
    peak = float(camera.responsivity.max())
    if camera.absolute and peak < LEAST_EFFICIENCY:
        return f"the peak quantum efficiency is {100 * peak:.3g} % only; {likely_mistake(peak)}"
    if camera.fit and camera.fit.photo and (wrong := _photo_shortfall(camera.fit.photo, camera.channels)):
        return wrong
    validation = camera.fit.validation if camera.fit else None
    if validation is None:
        return None
    for index, name in enumerate(camera.channels):
        fit, rmse = float(validation.r_squared[index]), float(validation.relative_rmse[index])
        if fit < LEAST_R_SQUARED or rmse > MOST_RMSE:
            return (
                f"channel {name} is predicted with R² {fit:.4f} and a relative RMSE of {100 * rmse:.2f} %, "
                f"{LEAST_R_SQUARED} and {100 * MOST_RMSE:g} % are wanted; check lights and captures"
            )
    return None


def _photo_shortfall(fit: PhotoFit, channels: tuple[str, ...]) -> str | None:
    """Return the reason not to trust photos of charts: a light that is hardly the one named, or patches that do not fit."""
    for index, name in enumerate(fit.names):
        if not fit.guessed[index] and fit.deficit[index] > NOTICED:
            return (
                f"{name}: its patches are e^{fit.deficit[index]:.0f} times more probable under {fit.nearest[index]} than "
                f"under {fit.lights[index]}; give its light, or a CSV of its spectrum"
            )
        worst = int(fit.misfit[index].argmax())
        if fit.misfit[index, worst] > MOST_MISFIT:
            return (
                f"{name}: the patches of the chart are off by {100 * fit.misfit[index, worst]:.1f} % of the brightest in "
                f"channel {channels[worst]}, {100 * MOST_MISFIT:g} % may be; check chart and light"
            )
    return None
