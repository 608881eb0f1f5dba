"""Compute a scene's white point and white balance (docs/method.md#scene-white).

White balance has two steps. Before rendering, each channel is multiplied by a gain. After rendering, a matrix adapts the
outputs from the scene's white point to D65.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.classes.tree import BORDER_PIXELS
from l3cli.errors import InputFileError
from l3cli.frames.frame import RawFrame
from l3cli.frames.lens_warp import GREEN, source_places
from l3cli.physics import spectra
from l3cli.physics.correlated_lights import CorrelatedLight, light_of, light_of_neutral, light_of_white, temperature, uv
from l3cli.physics.display import adaptation_matrix, display_white, fit_through
from l3cli.physics.mosaic import shifted_cfa, tiled
from l3cli.rendering.reference import ReferenceRenderer

Array = NDArray[np.floating]
MAX_CLIPPED = 0.01  # a grey area may contain at most this fraction of clipped pixels
FLAT = 0.5  # a channel counts as clipped if more than this fraction of its pixels have the frame's largest value
MIN_CERTAINTY = 50.0  # smallest ratio of a channel's mean signal in a grey area to the standard error of this mean
# A grey area with a ratio below MIN_CERTAINTY is reported as too dark if its signal is below this fraction of full scale.
# Otherwise, it is reported as not uniform.
DARK_FRACTION = 0.01


@dataclass(frozen=True)
class Grey:
    """A rectangular area of a frame that shows a grey object."""

    name: str  # name of the area in messages
    where: tuple[slice, slice]  # rows and columns in sensor orientation


@dataclass(frozen=True)
class Square:
    """A square in the coordinates of the upright picture."""

    row: int  # row of the centre
    col: int  # column of the centre
    size: int  # side in pixels

    def within(self, frame: RawFrame) -> Grey:
        """Find the area of a frame that the square covers.

        Raises
        ------
        InputFileError
            If the square extends beyond the frame.
        """
        rows, cols = frame.values.shape
        turned = bool(frame.orientation & 4)
        height, width = (cols, rows) if turned else (rows, cols)
        top, left = self.row - self.size // 2, self.col - self.size // 2
        if min(top, left) < 0 or top + self.size > height or left + self.size > width:
            raise InputFileError(
                f"{frame.name}: the {self.size}×{self.size} square around row {self.row}, column {self.col} extends beyond "
                f"the picture ({height}×{width} pixels); choose a square inside the picture"
            )
        top, left = (left, top) if turned else (top, left)
        top = rows - top - self.size if frame.orientation & 2 else top
        left = cols - left - self.size if frame.orientation & 1 else left
        if frame.warps:  # the square refers to the picture after lens correction
            half = (self.size - 1) / 2
            middle = source_places(frame.warps, np.array(top + half), np.array(left + half), GREEN)
            moved = [round(float(place) - half) for place in middle]
            top, left = (int(np.clip(at, 0, length - self.size)) for at, length in zip(moved, (rows, cols), strict=True))
        where = slice(top, top + self.size), slice(left, left + self.size)
        return Grey(f"{frame.name}: the square at {self.row},{self.col}", where)


class GreyRenderer:
    """Renders grey areas on the CPU in float64, so that the white point does not depend on the OpenCL device."""

    def __init__(self, table: TransformTable) -> None:
        self.table = table
        self._renderer = ReferenceRenderer(table)
        self._reach = table.first.rule.radius + sum(max(BORDER_PIXELS, layer.radius) for layer in table.later)

    def outputs_of(self, shares: Array) -> NDArray[np.float64]:
        """Render uniform areas to X, Y and Z.

        Parameters
        ----------
        shares : ndarray, (area, channel)
            Channel signals of each area, as fractions of full scale.

        Returns
        -------
        ndarray, (area, 3)
        """
        table, (rows, cols) = self.table, self.table.cfa.shape
        down, across = (1 + 2 * -(-self._reach // period) for period in (rows, cols))  # CFA periods per area
        tile = np.tile(table.cfa, (down, across))
        values = table.black_level + np.hstack([share[tile] for share in shares]) * (table.white_level - table.black_level)
        plain = RawFrame("plain areas", np.rint(values).astype(np.uint16), table.black_level, table.white_level)
        middle = self._renderer.exact_outputs(plain)[:, down // 2 * rows :][:, :rows]
        areas = middle.reshape(len(table.outputs), rows, len(shares), across, cols)[:, :, :, across // 2]
        return np.asarray(areas.mean(axis=(1, 3)).T[:, :3], np.float64)

    def signals(self, frame: RawFrame, grey: Grey) -> NDArray[np.float64]:
        """Return the mean signal of each channel in a grey area, in DN above black level and dark signal.

        Raises
        ------
        InputFileError
            If the area is clipped, too dark, not uniform, or too small.
        """
        means, why = _measured(frame, self.table, grey.where)
        if why:
            raise InputFileError(f"{grey.name} {why}")
        return means

    def usable(self, frame: RawFrame, grey: Grey) -> bool:
        """Whether a grey area is suitable for `signals`: not clipped, not too dark, uniform, and large enough."""
        return not _measured(frame, self.table, grey.where)[1]

    def of_part(self, frame: RawFrame, where: tuple[slice, slice]) -> NDArray[np.float64]:
        """Render the area `where` (rows and columns in sensor orientation), and return its mean X, Y and Z."""
        rows, cols = where
        margin = self._reach + max(self.table.cfa.shape)
        top, left = max(rows.start - margin, 0), max(cols.start - margin, 0)
        cut = _shading_corrected(frame, (slice(top, rows.stop + margin), slice(left, cols.stop + margin)))
        phase = ((frame.phase[0] + top) % self.table.cfa.shape[0], (frame.phase[1] + left) % self.table.cfa.shape[1])
        planes = self._renderer.exact_outputs(replace(cut, phase=phase))
        inside = planes[:, rows.start - top : rows.stop - top, cols.start - left : cols.stop - left]
        return np.asarray(inside[:3].mean(axis=(1, 2)))


def _shading_corrected(frame: RawFrame, where: tuple[slice, slice]) -> RawFrame:
    """Crop a frame to a small area, and correct its colour shading.

    The mean shading of all channels is ignored, because it is nearly constant over a small area. The result has the `phase`
    of the whole frame.
    """
    shading = frame.shading
    cut = None if shading is None else replace(shading, colour=None if shading.colour is None else shading.colour[where])
    return replace(replace(frame, values=frame.values[where], shading=cut).shading_corrected(), shading=None)


def _measured(frame: RawFrame, table: TransformTable, where: tuple[slice, slice]) -> tuple[NDArray[np.float64], str]:
    """Return each channel's mean signal in an area, in DN, and why the area cannot be used ("" if it can).

    The reason continues a sentence that starts with the area's name: "is clipped in 12% of its pixels; …".
    """
    values, means = _shading_corrected(frame, where).values, np.zeros(len(table.channels))
    clipped = float((values >= frame.white_level).mean())
    if clipped > MAX_CLIPPED:
        return means, f"is clipped in {clipped:.0%} of its pixels; choose a darker grey"
    cfa = shifted_cfa(table.cfa, (frame.phase[0] + where[0].start, frame.phase[1] + where[1].start))
    channel = tiled(cfa, values.shape)
    top, reached = int(frame.values.max()), 0  # largest value in the frame, and how many channels clip at it
    for index, letter in enumerate(table.channels):
        seen = values[channel == index] - (frame.black_level + frame.dark)
        if seen.size < 2:
            return means, f"contains too few pixels of channel {letter}; choose a larger square"
        means[index] = seen.mean()
        if not means[index] > MIN_CERTAINTY * seen.std() / np.sqrt(seen.size):
            if means[index] > DARK_FRACTION * (frame.white_level - frame.black_level):
                varies = seen.std() / means[index]
                return means, f"is not uniform: channel {letter} varies by {varies:.0%}; choose a uniform grey area"
            return means, f"is too dark: the mean of channel {letter} is {means[index]:.3g} DN; choose a brighter grey"
        reached += bool((values[channel == index] == top).mean() > FLAT)
    if reached > 1:
        return means, f"is clipped at {top} DN, below the white level of {frame.white_level:g} DN; correct ‹white_level›"
    return means, ""


TIME_CONSTANT = 1.0  # s; time constant with which exposure and white balance adapt to a change in lighting


@dataclass(frozen=True)
class WhiteBalance:
    """Channel gains to apply before rendering, and an output matrix to apply afterwards."""

    gains: NDArray[np.float64]  # (channel) at least 1, so that clipped pixels stay at the white level
    adaptation: NDArray[np.float64]  # (3, 3) adapts X, Y, Z to D65, and preserves the Y of white
    luminance: float  # Y of a grey area rendered without the gains, divided by its Y with the gains


def adaptation(white: Array) -> NDArray[np.float64]:
    """Return the Bradford matrix (3, 3) from the white point `white` (XYZ) to D65."""
    return np.asarray(adaptation_matrix(white, display_white()), np.float64)


def plain_balance(white: Array, channels: int) -> WhiteBalance:
    """Return a white balance without gains, with the outputs adapted from `white` (XYZ) to D65."""
    return WhiteBalance(np.ones(channels), adaptation(white), 1.0)


def balanced(frame: RawFrame, table: TransformTable, gains: Array) -> RawFrame:
    """Multiply the channels of a frame by white-balance gains, and clip them at the white level."""
    if (gains == 1).all():
        return frame
    curves = _curves(frame.black_level + frame.dark, frame.white_level, tuple(gains.tolist()))
    values, cfa = frame.values.copy(), shifted_cfa(table.cfa, frame.phase)
    for row, col in np.ndindex(cfa.shape):
        if gains[cfa[row, col]] != 1:
            site = np.s_[row :: cfa.shape[0], col :: cfa.shape[1]]
            values[site] = curves[cfa[row, col]].take(frame.values[site])
    return replace(frame, values=values)


def balanced_patches(patches: RawFrame, channel: NDArray[np.integer], gains: Array) -> RawFrame:
    """Apply white-balance gains to patches (patch, tap), like `balanced`. `channel` (tap,) is the channel of each tap."""
    if (gains == 1).all():
        return patches
    curves = _curves(patches.black_level + patches.dark, patches.white_level, tuple(gains.tolist()))
    return replace(patches, values=curves[channel[None], patches.values])


@functools.lru_cache(maxsize=8)
def _curves(zero: float, white_level: float, gains: tuple[float, ...]) -> NDArray[np.uint16]:
    """Return look-up tables (channel, raw value) that apply the white-balance gains to 16-bit values.

    `zero` is the raw value without light. Values at or above the white level do not change.
    """
    every = np.arange(1 << 16)
    raised = np.rint((every - zero) * np.array(gains)[:, None] + zero)
    return np.where(every < white_level, np.clip(raised, 0, np.ceil(white_level)), every).astype(np.uint16)


class SteadyWhite:
    """Smooths the white balance of a sequence over time, frame by frame.

    The first frame uses its measured white balance. Afterwards, the white balance approaches the measured values
    exponentially, with the same time constant as the automatic exposure. Later frames do not affect a frame's white balance.
    """

    def __init__(self, rate: Fraction) -> None:
        self._share = followed_share(rate)
        self._now: WhiteBalance | None = None

    def balance(self, wanted: WhiteBalance | None) -> WhiteBalance | None:
        """Return the smoothed white balance for the next frame, or None as long as no white balance has been measured.

        `wanted` is the white balance measured in this frame. If it is None, the result is the previous frame's white
        balance.
        """
        if wanted is not None:
            self._now = wanted if self._now is None else _between(self._now, wanted, self._share)
        return self._now


def followed_share(rate: Fraction) -> float:
    """Return the fraction of a sudden change by which exposure and white balance follow within one frame.

    `rate` is in frames per second.
    """
    return 1 - math.exp(-1 / (float(rate) * TIME_CONSTANT))


def _between(now: WhiteBalance, wanted: WhiteBalance, share: float) -> WhiteBalance:
    gains = now.gains * (wanted.gains / now.gains) ** share
    matrix = now.adaptation + share * (wanted.adaptation - now.adaptation)
    return WhiteBalance(gains, matrix, now.luminance * (wanted.luminance / now.luminance) ** share)


# Signal of the brightest channel in rendered grey areas, as a fraction of full scale. Every table is well trained at this
# level.
GREY_LEVEL = 0.4
MAX_GAIN = 8.0  # largest channel gain; a channel that needs more contains mostly noise
SURFACES = 64  # number of measured reflectances to which the colour correction is fitted
UNSURE = 1e-3  # expected error of rendered colours; its square is the ridge penalty of the colour correction's fit
MIN_WEIGHT_LUMINANCE = 0.05  # darker surfaces are weighted like a surface of this relative luminance
MAX_DUV = 0.03  # largest plausible distance of an illuminant from the black-body locus in CIE 1960 uv
SAME_WHITE = 5e-4  # white points closer than this in CIE 1960 uv count as equal, because users enter rounded values
MAX_MISFIT = 0.12  # largest plausible RMS misfit of the log channel signals; real lamps reach at most half of it
NEAR_WHITE = 0.02  # white points farther apart than this in CIE 1976 u′v′ belong to different illuminants
COOLEST, WARMEST = 24_000.0, 1_700.0  # range of plausible colour temperatures, in K


@dataclass(frozen=True)
class SceneWhite:
    """White point of a scene: its most probable illuminant, and the white balance that makes grey objects neutral."""

    balance: WhiteBalance
    light: CorrelatedLight  # most probable illuminant with this white point
    modelled: bool  # whether the white balance was computed from the responsivities of the table's camera

    @property
    def plausible(self) -> bool:
        """Whether daylight, shade or a real lamp could have this white point."""
        return _is_plausible(self.light)

    def __str__(self) -> str:
        light = self.light
        x, y = light.xyz[:2] / light.xyz.sum()
        side = "green" if light.duv >= 0 else "pink"
        return f"x,y = {x:.4f},{y:.4f}, {light.kelvin:.0f} K, {abs(light.duv):.3f} towards {side} in u, v"


class Whites:
    """Computes white balances for one table.

    The channel gains give grey objects the channel ratios that they have under the training illuminant. Without the gains,
    highlights and the edges of grey objects would be coloured. The gains can be computed only if the table contains its
    camera and its training illuminant.

    If the table contains its camera and the scene illuminant is plausible, the output matrix also corrects surface colours.
    """

    def __init__(self, table: TransformTable) -> None:
        self.table = table

    @functools.cached_property
    def grey(self) -> GreyRenderer:
        return GreyRenderer(self.table)

    @functools.cached_property
    def trained(self) -> NDArray[np.float64] | None:
        """Channel signals of a perfect white under the training illuminant, in relative units.

        None if the table does not contain both its camera and its training illuminant.
        """
        camera, light = self.table.camera, self.table.light
        if camera is None or light is None:
            return None
        return camera.signal_weights @ spectra.resample(light.radiance, light.wavelength, camera.wavelength)

    def of_neutral(self, neutral: Array) -> SceneWhite:
        """Return the white point of a scene in which a grey object has the given channel signals.

        Parameters
        ----------
        neutral : ndarray, (channel,)
            Signals of the grey object above black, in any unit.

        Raises
        ------
        InputFileError
            If a signal is not finite, if no signal is positive, or if the table renders a non-positive X, Y or Z.
        """
        if not (np.isfinite(neutral).all() and neutral.max() > 0):
            shown = ", ".join(f"{each:g}" for each in neutral)
            raise InputFileError(
                f"the channel signals of the white are {shown}, but must be finite and not all zero; set a different ‹white›"
            )
        camera = self.table.camera
        if camera is None:
            return self.of_xyz(self._shown(neutral))
        light = light_of_neutral(camera.signal_weights, camera.wavelength, neutral)
        return SceneWhite(self._balance(neutral, light), light, True)

    def of_light(self, name: str) -> SceneWhite:
        """Return the white point of a named illuminant, such as "D65".

        Raises
        ------
        RecipeError
            If the name is unknown.
        """
        white, camera = spectra.white_point(name), self.table.camera
        if camera is None:
            return self.of_xyz(white)
        radiance = spectra.illuminant(name, camera.wavelength)
        light = CorrelatedLight(white, *temperature(white), 0.0, radiance)
        return SceneWhite(self._balance(camera.signal_weights @ radiance, light), light, True)

    def of_chromaticity(self, white: Array) -> SceneWhite:
        """Return the white point of a scene in which a white object has the given XYZ.

        The illuminant is assumed to be the nearest black body or daylight with a green or magenta tint. In three cases, the
        result has no gains, as in `of_xyz`: if this illuminant is implausible, if `white` is the table's own white point, or
        if the table does not contain its camera.
        """
        camera = self.table.camera
        if camera is None or np.linalg.norm(uv(white) - uv(self.table.white_point[:3])) < SAME_WHITE:
            return self.of_xyz(white)
        light = light_of_white(white, camera.wavelength)
        if not _is_plausible(light):
            return self.of_xyz(white)
        assert light.radiance is not None
        return SceneWhite(self._balance(camera.signal_weights @ light.radiance, light), light, True)

    def of_xyz(self, white: Array) -> SceneWhite:
        """Return the white point of a scene in which a white object has the given XYZ.

        Its white balance has no gains, and only adapts the outputs.
        """
        return SceneWhite(plain_balance(white, len(self.table.channels)), light_of(white), False)

    def of_greys(self, frame: RawFrame, greys: Sequence[Grey]) -> SceneWhite:
        """Return the white point that makes several grey areas as neutral as possible.

        It approximately minimises the sum of squared chroma C*ab over the areas.

        Raises
        ------
        InputFileError
            If a grey area is clipped, too dark, not uniform, or too small.
        """
        signals = np.array([self.grey.signals(frame, grey) for grey in greys])
        share = signals.mean(axis=1) / signals.mean(axis=1).max()
        weights = share ** (2 / 3) / share  # for a given cast, C*ab is proportional to the cube root of luminance
        made = self.of_neutral(weights @ signals)
        even = balanced(frame, self.table, made.balance.gains)
        whole = [number for number, grey in enumerate(greys) if self.grey.usable(even, grey)]  # unclipped after the gains
        if not whole:
            return made
        shown = weights[whole] @ np.array([self.grey.of_part(even, greys[number].where) for number in whole])
        left = made.balance.adaptation @ _white(shown)  # cast that remains in the rendered grey areas
        return replace(made, balance=replace(made.balance, adaptation=adaptation(left) @ made.balance.adaptation))

    def _balance(self, neutral: Array, light: CorrelatedLight) -> WhiteBalance:
        gains = self._gains(neutral)
        before, after = self._shown(neutral)[1], self._shown(neutral * gains)[1]
        raised = (neutral * gains).max() / neutral.max()
        matrix = adaptation(self._shown(neutral * gains))
        if light.radiance is not None and _is_plausible(light):
            matrix = self._correction(light.radiance, gains) @ matrix
        return WhiteBalance(gains, matrix, float(before / after / raised))

    def _gains(self, neutral: Array) -> NDArray[np.float64]:
        """Return the channel gains, at least 1, that give a grey object its channel ratios under the training illuminant."""
        if self.trained is None:
            return np.ones(len(neutral))
        seen = (neutral > 0) & (self.trained > 0)  # under some lamps, an infrared channel receives no light
        ratio = np.where(seen, self.trained / np.where(seen, neutral, 1.0), 0.0)
        return np.clip(ratio / ratio.min(where=seen, initial=np.inf), 1.0, MAX_GAIN)

    def _shown(self, neutral: Array) -> NDArray[np.float64]:
        """Render a grey object with the given channel signals to X, Y and Z."""
        return _white(self.grey.outputs_of(GREY_LEVEL * neutral[None] / neutral.max())[0])

    def _correction(self, radiance: Array, gains: Array) -> NDArray[np.float64]:
        """Return a matrix (3, 3) that corrects surface colours after white balance, and preserves white.

        It is fitted to measured reflectances under the illuminant `radiance`, on the camera's wavelength grid.
        """
        camera = self.table.camera
        assert camera is not None
        surfaces = _surfaces(tuple(camera.wavelength))
        with_white = np.vstack([surfaces, np.ones(camera.wavelength.size)]) * radiance
        signals = with_white @ camera.signal_weights.T * gains
        shown = self.grey.outputs_of(signals * (GREY_LEVEL / signals[-1].max()))
        true = with_white @ spectra.xyz_weights(camera.wavelength).T
        ours, ideal = (of[:-1] / of[-1, 1] @ adaptation(_white(of[-1])).T for of in (shown, true))
        weights = 1.0 / np.maximum(ideal[:, 1:2], MIN_WEIGHT_LUMINANCE)  # the eye perceives errors relative to luminance
        through = display_white(), display_white()
        return np.asarray(fit_through(ours * weights, ideal * weights, *through, UNSURE**2), np.float64)


def _is_plausible(light: CorrelatedLight) -> bool:
    return abs(light.duv) <= MAX_DUV and light.misfit <= MAX_MISFIT and WARMEST < light.kelvin < COOLEST


@functools.lru_cache(1)
def _surfaces(wavelength: tuple[float, ...]) -> Array:
    """Select the reflectances (surface, wavelength) of `SURFACES` surfaces from the reflectance library."""
    library = spectra.reflectance_library(np.array(wavelength))
    return np.asarray(library[np.linspace(0, len(library) - 1, SURFACES).round().astype(int)])


def _white(outputs: Array) -> NDArray[np.float64]:
    """Return the XYZ of a grey area as float64. Raises InputFileError unless all three are finite and positive."""
    if not (np.isfinite(outputs).all() and outputs.min() > 0):
        shown = ", ".join(f"{each:.3g}" for each in outputs)
        raise InputFileError(
            f"the table renders the grey area as X, Y, Z = {shown}, but all three must be positive; "
            "use a table for this camera"
        )
    return np.asarray(outputs, np.float64)


# ------------------------------------------------------------------------------------------------------- warnings


def far_from_training(asked: str, white: SceneWhite, table: TransformTable) -> str:
    """Return a warning if the user's white point is probably far from the training illuminants, otherwise ""."""
    if (white.modelled and "," not in asked) or _alike(white.light.xyz, table.white_point[:3]):
        return ""
    x, y = table.white_point[:2] / table.white_point[:3].sum()
    how = (
        "l3 only adapts the colours; set ‹white› to the name of the scene's illuminant, or add this illuminant to the "
        "scene recipe and train again"
    )
    if white.modelled:
        how = (
            "l3 assumes a black body or daylight; for a fluorescent or LED lamp, set ‹white› to the name of the "
            "illuminant or to the ROW,COL of a grey area"
        )
    return f"‹white› {asked} is far from the mean training illuminant (x,y = {x:.4f},{y:.4f}), so {how}"


def implausible(what: str, white: SceneWhite) -> str:
    """Return a warning if no plausible illuminant has this white point, otherwise "".

    `what` describes the white point at the start of the warning.
    """
    if white.plausible:
        return ""
    return (
        f"{what} ({white}) does not match any daylight, lamp or black body for the table's camera, so l3 makes greys "
        "neutral but does not correct other colours; check that the table is for this camera, or set another ‹white›"
    )


def unlike_stated(name: str, white: SceneWhite, stated: SceneWhite) -> str:
    """Return a warning if the file's white point differs from the one measured on the chart, otherwise ""."""
    if _alike(white.light.xyz, stated.light.xyz):
        return ""
    return (
        f"{name}: the white balance in the file is {stated.light.kelvin:.0f} K, but the chart measures "
        f"{white.light.kelvin:.0f} K; l3 uses the chart, because ‹white› camera would leave a colour cast"
    )


def _alike(one: Array, other: Array) -> bool:
    """Whether two white points (XYZ) are close enough for the same illuminant."""
    difference = (uv(one) - uv(other)) * (1.0, 1.5)  # CIE 1976 u′v′
    return float(np.linalg.norm(difference)) <= NEAR_WHITE
