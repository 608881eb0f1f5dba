"""The white of a scene, and the white balance of frames (docs/method.md#scene-white).

Before a table renders a frame, gains are applied to the channels. After rendering, the outputs are adapted to the white.
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
from l3cli.physics import spectra
from l3cli.physics.correlated_lights import CorrelatedLight, light_of, light_of_neutral, light_of_white, temperature, uv
from l3cli.physics.display import adaptation_matrix, display_white, fit_through
from l3cli.physics.mosaic import shifted_cfa, tiled
from l3cli.rendering.reference import ReferenceRenderer

Array = NDArray[np.floating]
MAX_CLIPPED = 0.01  # largest fraction of clipped pixels in a usable square
FLAT = 0.5  # a channel counts as clipped if at least this fraction of its pixels has the frame's highest value
DARK_FRACTION = 0.01  # fraction of full scale; low certainty is attributed to noise below it, to a pattern above
MIN_CERTAINTY = 50.0  # smallest mean signal of a channel in a square, divided by the standard deviation of this mean


@dataclass(frozen=True)
class Grey:
    """A part of a frame that shows a grey object."""

    name: str  # name for messages
    where: tuple[slice, slice]  # rows and columns on the sensor


@dataclass(frozen=True)
class Square:
    """A square in the upright picture."""

    row: int  # row of the centre
    col: int  # column of the centre
    size: int  # side in pixels

    def within(self, frame: RawFrame) -> Grey:
        """Return the part of a frame in this square. Raises InputFileError if it extends beyond the frame."""
        rows, cols = frame.values.shape
        turned = bool(frame.orientation & 4)
        height, width = (cols, rows) if turned else (rows, cols)
        top, left = self.row - self.size // 2, self.col - self.size // 2
        if min(top, left) < 0 or top + self.size > height or left + self.size > width:
            raise InputFileError(
                f"{frame.name}: a square of {self.size} pixels about row {self.row}, column {self.col} is not inside its "
                f"{height}×{width} pixels; give a grey inside the picture"
            )
        top, left = (left, top) if turned else (top, left)
        top = rows - top - self.size if frame.orientation & 2 else top
        left = cols - left - self.size if frame.orientation & 1 else left
        where = slice(top, top + self.size), slice(left, left + self.size)
        return Grey(f"{frame.name}: the grey at {self.row},{self.col}", where)


class GreyRenderer:
    """Renders uniform areas on the CPU in float64, so that the white does not depend on the device."""

    def __init__(self, table: TransformTable) -> None:
        self.table = table
        self._renderer = ReferenceRenderer(table)
        self._reach = table.first.rule.radius + sum(max(BORDER_PIXELS, layer.radius) for layer in table.later)

    def outputs_of(self, shares: Array) -> NDArray[np.float64]:
        """Return the outputs (area, output) of uniform areas. Their signals (area, channel) are fractions of full scale."""
        table, (rows, cols) = self.table, self.table.cfa.shape
        down, across = (1 + 2 * -(-self._reach // period) for period in (rows, cols))  # size of an area in CFA periods
        tile = np.tile(table.cfa, (down, across))
        values = table.black_level + np.hstack([share[tile] for share in shares]) * (table.white_level - table.black_level)
        plain = RawFrame("plain areas", np.rint(values).astype(np.uint16), table.black_level, table.white_level)
        middle = self._renderer.exact_outputs(plain)[:, down // 2 * rows :][:, :rows]
        areas = middle.reshape(len(table.outputs), rows, len(shares), across, cols)[:, :, :, across // 2]
        return np.asarray(areas.mean(axis=(1, 3)).T, np.float64)

    def signals(self, frame: RawFrame, grey: Grey) -> NDArray[np.float64]:
        """Return the mean signal (channel) of a grey in a frame, in DN above black and dark current.

        Raises
        ------
        InputFileError
            If the grey is clipped, too dark or not uniform, or contains too few pixels of a channel.
        """
        means, why = _measured(frame, self.table, grey.where)
        if why:
            raise InputFileError(f"{grey.name} {why}")
        return means

    def usable(self, frame: RawFrame, grey: Grey) -> bool:
        """Return whether the signals of a grey can be measured."""
        return not _measured(frame, self.table, grey.where)[1]

    def of_part(self, frame: RawFrame, where: tuple[slice, slice]) -> NDArray[np.float64]:
        """Return the mean outputs over a range of rows and columns of a frame, in sensor orientation."""
        rows, cols = where
        margin = self._reach + max(self.table.cfa.shape)
        top, left = max(rows.start - margin, 0), max(cols.start - margin, 0)
        cut = _shading_corrected(frame, (slice(top, rows.stop + margin), slice(left, cols.stop + margin)))
        phase = ((frame.phase[0] + top) % self.table.cfa.shape[0], (frame.phase[1] + left) % self.table.cfa.shape[1])
        planes = self._renderer.exact_outputs(replace(cut, phase=phase))
        inside = planes[:, rows.start - top : rows.stop - top, cols.start - left : cols.stop - left]
        return np.asarray(inside.mean(axis=(1, 2)))


def _shading_corrected(frame: RawFrame, where: tuple[slice, slice]) -> RawFrame:
    """Return a part of a frame with its colour shading corrected.

    Shading that is common to all channels is not corrected, because it is nearly uniform in a small part. The phase is still
    that of the whole frame.
    """
    shading = frame.shading
    cut = None if shading is None else replace(shading, colour=None if shading.colour is None else shading.colour[where])
    return replace(replace(frame, values=frame.values[where], shading=cut).shading_corrected(), shading=None)


def _measured(frame: RawFrame, table: TransformTable, where: tuple[slice, slice]) -> tuple[NDArray[np.float64], str]:
    """Return the mean signal (channel) of a part of a frame in DN, and the reason why it is not a usable grey, or ""."""
    values, means = _shading_corrected(frame, where).values, np.zeros(len(table.channels))
    clipped = float((values >= frame.white_level).mean())
    if clipped > MAX_CLIPPED:
        return means, f"is clipped in {clipped:.0%} of its pixels; give a darker grey"
    cfa = shifted_cfa(table.cfa, (frame.phase[0] + where[0].start, frame.phase[1] + where[1].start))
    channel = tiled(cfa, values.shape)
    top, reached = int(frame.values.max()), 0  # highest value in the frame; number of channels that clip at this value
    for index, letter in enumerate(table.channels):
        seen = values[channel == index] - (frame.black_level + frame.dark)
        if seen.size < 2:
            return means, f"has too few pixels of channel {letter}; give a larger size"
        means[index] = seen.mean()
        if not means[index] > MIN_CERTAINTY * seen.std() / np.sqrt(seen.size):
            if means[index] > DARK_FRACTION * (frame.white_level - frame.black_level):
                varies = seen.std() / means[index]
                return means, f"is not uniform: channel {letter} varies by {varies:.0%}; give an area of one colour"
            return means, f"is too dark: channel {letter} has {means[index]:.3g} DN; give a brighter grey"
        reached += bool((values[channel == index] == top).mean() > FLAT)
    if reached > 1:
        return means, f"is clipped at {top} DN, below the white level of {frame.white_level:g}; correct ‹white_level›"
    return means, ""


TIME_CONSTANT = 1.0  # s; in this time, exposure and white follow 63 % of a change of light


@dataclass(frozen=True)
class WhiteBalance:
    """Gains and adaptation that make the white of a scene neutral."""

    gains: NDArray[np.float64]  # (channel) at least 1, so that clipped pixels stay at the white level
    adaptation: NDArray[np.float64]  # (3, 3) from a table's X, Y, Z to XYZ under D65; preserves the Y of white
    luminance: float  # Y of a grey without the gains, divided by its Y with the gains


def adaptation(white: Array) -> NDArray[np.float64]:
    """Return the Bradford adaptation (3, 3) from a white (3) to D65."""
    return np.asarray(adaptation_matrix(white, display_white()), np.float64)


def plain_balance(white: Array, channels: int) -> WhiteBalance:
    """Return a balance without gains that adapts from a white (3)."""
    return WhiteBalance(np.ones(channels), adaptation(white), 1.0)


def balanced(frame: RawFrame, table: TransformTable, gains: Array) -> RawFrame:
    """Multiply the channels of a frame by gains. Values are limited to the white level."""
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
    """Multiply patches (patch, tap) by gains, as in `balanced`. `channel` (tap) is the channel of each tap."""
    if (gains == 1).all():
        return patches
    curves = _curves(patches.black_level + patches.dark, patches.white_level, tuple(gains.tolist()))
    return replace(patches, values=curves[channel[None], patches.values])


@functools.lru_cache(maxsize=8)
def _curves(zero: float, white_level: float, gains: tuple[float, ...]) -> NDArray[np.uint16]:
    """Return look-up tables (channel, value) from 16-bit values to balanced values. Clipped values do not change."""
    every = np.arange(1 << 16)
    raised = np.rint((every - zero) * np.array(gains)[:, None] + zero)
    return np.where(every < white_level, np.clip(raised, 0, np.ceil(white_level)), every).astype(np.uint16)


class SteadyWhite:
    """Computes the white balance of each frame of a sequence, in order.

    The first frame has its own balance. After that, the balance approaches that of each frame exponentially, like the
    exposure. It does not depend on later frames.
    """

    def __init__(self, rate: Fraction) -> None:
        self._share = followed_share(rate)
        self._now: WhiteBalance | None = None

    def balance(self, wanted: WhiteBalance | None) -> WhiteBalance | None:
        """Return the balance of the next frame.

        A frame without a measured white has the balance of the previous frame, which is None at the beginning.
        """
        if wanted is not None:
            self._now = wanted if self._now is None else _between(self._now, wanted, self._share)
        return self._now


def followed_share(rate: Fraction) -> float:
    """Return the fraction of a change by which exposure and white follow it from one frame to the next."""
    return 1 - math.exp(-1 / (float(rate) * TIME_CONSTANT))


def _between(now: WhiteBalance, wanted: WhiteBalance, share: float) -> WhiteBalance:
    gains = now.gains * (wanted.gains / now.gains) ** share
    matrix = now.adaptation + share * (wanted.adaptation - now.adaptation)
    return WhiteBalance(gains, matrix, now.luminance * (wanted.luminance / now.luminance) ** share)


GREY_LEVEL = 0.4  # fraction of full scale in the brightest channel, a level with many training patches
MAX_GAIN = 8.0  # largest gain of a channel; with a higher gain, the channel would mostly be noise
SURFACES = 64  # number of measured reflectances to which the colour correction for an illuminant is fitted
UNSURE = 1e-3  # error of a rendered surface, which the correction must not amplify
MIN_WEIGHT_LUMINANCE = 0.05  # luminance relative to white; errors of darker surfaces are weighted as at this luminance
MAX_DUV = 0.03  # largest distance of a lamp from the black-body locus in CIE 1960 uv
SAME_WHITE = 5e-4  # whites are the same up to this distance in CIE 1960 uv, to allow for four-digit coordinates
MAX_MISFIT = 0.12  # largest RMS misfit of the logarithms of the channels; fluorescent and LED lamps reach half of it
NEAR_WHITE = 0.02  # two whites belong to different illuminants from this distance in CIE 1976 u′v′ on
COOLEST, WARMEST = 24_000.0, 1_700.0  # K; a search that ends beyond these limits has found nothing


@dataclass(frozen=True)
class SceneWhite:
    """The white of a scene, its white balance, and as far as known the illuminant with this white."""

    balance: WhiteBalance
    light: CorrelatedLight
    modelled: bool  # whether it was computed with the responsivities of the table's camera

    @property
    def plausible(self) -> bool:
        """Whether lamps, daylight or shade can have this white."""
        return _is_plausible(self.light)

    def __str__(self) -> str:
        light = self.light
        x, y = light.xyz[:2] / light.xyz.sum()
        side = "green" if light.duv >= 0 else "pink"
        return f"x,y = {x:.4f},{y:.4f}, {light.kelvin:.0f} K, {abs(light.duv):.3f} in uv to the {side}"


class Whites:
    """Computes the whites of scenes for a table.

    If the table contains its camera and its training illuminant, gains first give the channels of a frame the ratios that
    they have under the training illuminant. This is necessary for grey edges of grey objects and white highlights. A matrix
    then corrects the remaining colour errors of surfaces.
    """

    def __init__(self, table: TransformTable) -> None:
        self.table = table

    @functools.cached_property
    def grey(self) -> GreyRenderer:
        return GreyRenderer(self.table)

    @functools.cached_property
    def trained(self) -> NDArray[np.float64] | None:
        """Signals (channel) of a grey under the training illuminant. None if the table does not contain camera and light."""
        camera, light = self.table.camera, self.table.light
        if camera is None or light is None:
            return None
        return camera.signal_weights @ spectra.resample(light.radiance, light.wavelength, camera.wavelength)

    def of_neutral(self, neutral: Array) -> SceneWhite:
        """Return the white for which a neutral object has the signals `neutral` (channel), at any scale.

        Raises InputFileError if the table cannot render these signals as a white.
        """
        if not (np.isfinite(neutral).all() and neutral.max() > 0):
            raise InputFileError("all channels of the white are zero, or one is not finite; give another ‹white›")
        camera = self.table.camera
        if camera is None:
            return self.of_xyz(self._shown(neutral))
        light = light_of_neutral(camera.signal_weights, camera.wavelength, neutral)
        return SceneWhite(self._balance(neutral, light), light, True)

    def of_light(self, name: str) -> SceneWhite:
        """Return the white of a standard illuminant. Raises RecipeError if the name is unknown."""
        white, camera = spectra.white_point(name), self.table.camera
        if camera is None:
            return self.of_xyz(white)
        radiance = spectra.illuminant(name, camera.wavelength)
        light = CorrelatedLight(white, *temperature(white), 0.0, radiance)
        return SceneWhite(self._balance(camera.signal_weights @ radiance, light), light, True)

    def of_chromaticity(self, white: Array) -> SceneWhite:
        """Return the scene white for a known XYZ (3).

        If it agrees with the training white, pictures are adapted from it. Otherwise the illuminant is assumed to be the
        nearest black body or daylight, with a green or magenta tint. If no such illuminant is plausible, pictures are only
        adapted.
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
        """Return the scene white for a known XYZ (3), without gains, so that pictures are only adapted."""
        return SceneWhite(plain_balance(white, len(self.table.channels)), light_of(white), False)

    def of_greys(self, frame: RawFrame, greys: Sequence[Grey]) -> SceneWhite:
        """Return the white that makes several greys in a frame as neutral as possible, in terms of the sum of C*ab².

        Raises InputFileError if a grey is clipped, too dark or not uniform.
        """
        signals = np.array([self.grey.signals(frame, grey) for grey in greys])
        share = signals.mean(axis=1) / signals.mean(axis=1).max()
        weights = share ** (2 / 3) / share  # C*ab is proportional to the cube root of luminance
        made = self.of_neutral(weights @ signals)
        even = balanced(frame, self.table, made.balance.gains)
        whole = [number for number, grey in enumerate(greys) if self.grey.usable(even, grey)]  # gains can clip bright greys
        if not whole:
            return made
        shown = weights[whole] @ np.array([self.grey.of_part(even, greys[number].where) for number in whole])
        left = made.balance.adaptation @ _white(shown)  # remaining colour cast of the rendered greys
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
        """Return gains (channel) of at least 1 that bring a neutral close to that under the training illuminant."""
        if self.trained is None:
            return np.ones(len(neutral))
        seen = (neutral > 0) & (self.trained > 0)  # an infrared channel may receive no light from a lamp
        ratio = np.where(seen, self.trained / np.where(seen, neutral, 1.0), 0.0)
        return np.clip(ratio / ratio.min(where=seen, initial=np.inf), 1.0, MAX_GAIN)

    def _shown(self, neutral: Array) -> NDArray[np.float64]:
        """Return the output (3) of the table for a grey with the given signals."""
        return _white(self.grey.outputs_of(GREY_LEVEL * neutral[None] / neutral.max())[0])

    def _correction(self, radiance: Array, gains: Array) -> NDArray[np.float64]:
        """Fit the matrix (3, 3) that corrects the balanced and adapted outputs of measured surfaces, by least squares.

        It preserves white. `radiance` (wavelength) is that of the illuminant, on the camera's wavelength grid.
        """
        camera = self.table.camera
        assert camera is not None
        surfaces = _surfaces(tuple(camera.wavelength))
        with_white = np.vstack([surfaces, np.ones(camera.wavelength.size)]) * radiance
        signals = with_white @ camera.signal_weights.T * gains
        shown = self.grey.outputs_of(signals * (GREY_LEVEL / signals[-1].max()))
        true = with_white @ spectra.xyz_weights(camera.wavelength).T
        ours, ideal = (of[:-1] / of[-1, 1] @ adaptation(_white(of[-1])).T for of in (shown, true))
        weights = 1.0 / np.maximum(ideal[:, 1:2], MIN_WEIGHT_LUMINANCE)  # errors are visible relative to luminance
        through = display_white(), display_white()
        return np.asarray(fit_through(ours * weights, ideal * weights, *through, UNSURE**2), np.float64)


def _is_plausible(light: CorrelatedLight) -> bool:
    return abs(light.duv) <= MAX_DUV and light.misfit <= MAX_MISFIT and WARMEST < light.kelvin < COOLEST


@functools.lru_cache(1)
def _surfaces(wavelength: tuple[float, ...]) -> Array:
    """Return an evenly spaced selection of measured reflectances (surface, wavelength) from the library."""
    library = spectra.reflectance_library(np.array(wavelength))
    return np.asarray(library[np.linspace(0, len(library) - 1, SURFACES).round().astype(int)])


def _white(outputs: Array) -> NDArray[np.float64]:
    """Check the outputs (3) of a white, and return them. Raises InputFileError unless all are positive."""
    if not (np.isfinite(outputs).all() and outputs.min() > 0):
        raise InputFileError("the table does not render this grey as a white; give the table of this camera")
    return np.asarray(outputs, np.float64)


# ------------------------------------------------------------------------------------------------------- warnings


def far_from_training(asked: str, white: SceneWhite, table: TransformTable) -> str:
    """Return a warning if the requested white is probably far from the training illuminants, otherwise ""."""
    if (white.modelled and "," not in asked) or _alike(white.light.xyz, table.white_point):
        return ""
    x, y = table.white_point[:2] / table.white_point.sum()
    how = "colours are only adapted; name the light, or add it to the illuminants of SCENES.toml and train again"
    if white.modelled:
        how = "assuming a black body or daylight; for a fluorescent or LED lamp give its name, or the ROW,COL of a grey"
    return f"‹white› {asked} is far from the mean light of the training, x,y = {x:.4f},{y:.4f}: {how}"


def implausible(what: str, white: SceneWhite) -> str:
    """Return a warning if no likely illuminant has this white, otherwise ""."""
    if white.plausible:
        return ""
    return (
        f"{what} fits no daylight, lamp or black body for the table's camera ({white}); greys become neutral, other colours "
        "are not corrected; check that the table is for this camera, or give another ‹white›"
    )


def unlike_stated(name: str, white: SceneWhite, stated: SceneWhite) -> str:
    """Return a warning if the white in the file's metadata is far from the white of the chart in the frame, otherwise ""."""
    if _alike(white.light.xyz, stated.light.xyz):
        return ""
    return (
        f"{name}: its file states another white ({stated.light.kelvin:.0f} K) than its chart shows "
        f"({white.light.kelvin:.0f} K); using the chart's, because ‹white› camera would leave a cast"
    )


def _alike(one: Array, other: Array) -> bool:
    """Return whether two whites (XYZ) may belong to the same illuminant."""
    difference = (uv(one) - uv(other)) * (1.0, 1.5)  # CIE 1976 u′v′
    return float(np.linalg.norm(difference)) <= NEAR_WHITE
