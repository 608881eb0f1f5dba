"""The white of a scene, and how frames are balanced for it: gains of the channels before a table renders them, adaptation of
its outputs after (docs/method.md#scene-white)."""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.classes.tree import REACH
from l3cli.errors import InputFileError
from l3cli.frames.frame import RawFrame, shifted_cfa, tiled
from l3cli.physics import spectra
from l3cli.physics.correlated_lights import CorrelatedLight, light_of, light_of_neutral, light_of_white, temperature, uv
from l3cli.physics.display import adaptation_matrix, display_white, fit_through
from l3cli.rendering.reference import ReferenceRenderer

Array = NDArray[np.floating]
MOST_CLIPPED = 0.01  # share of a square's pixels that may be clipped
FLAT = 0.5  # share of the pixels of two channels that have the frame's highest value, all of them, where the sensor clips
DARK = 0.01  # of full scale: a mean below which noise may hide it, above which its spread is that of what is seen
LEAST_CERTAINTY = 50.0  # mean signal of a channel in a square over the standard deviation of that mean


@dataclass(frozen=True)
class Grey:
    """A part of a frame that shows something grey."""

    name: str  # for messages
    where: tuple[slice, slice]  # rows and columns on the sensor


@dataclass(frozen=True)
class Square:
    """A square of the upright picture."""

    row: int  # of its centre
    col: int  # of its centre
    size: int  # pixels

    def within(self, frame: RawFrame) -> Grey:
        """Return the grey at this place of a frame; InputFileError if it is not inside the sensor."""
        rows, cols = frame.values.shape
        turned = bool(frame.orientation & 4)
        height, width = (cols, rows) if turned else (rows, cols)
        top, left = self.row - self.size // 2, self.col - self.size // 2
        if min(top, left) < 0 or top + self.size > height or left + self.size > width:
            raise InputFileError(
                f"{frame.name}: a square of {self.size} pixels about row {self.row}, column {self.col} is not inside its "
                f"{height}×{width} pixels; give a grey in the picture"
            )
        top, left = (left, top) if turned else (top, left)
        top = rows - top - self.size if frame.orientation & 2 else top
        left = cols - left - self.size if frame.orientation & 1 else left
        where = slice(top, top + self.size), slice(left, left + self.size)
        return Grey(f"{frame.name}: the grey at {self.row},{self.col}", where)


class GreyRenderer:
    """Renderer of plain areas on the processor, in float64, so that all devices agree about white."""

    def __init__(self, table: TransformTable) -> None:
        self.table = table
        self._renderer = ReferenceRenderer(table)
        self._reach = table.first.rule.radius + sum(max(REACH, layer.radius) for layer in table.later)

    def outputs_of(self, shares: Array) -> NDArray[np.float64]:
        """Return outputs (area, output) of plain areas with signals `shares` (area, channel) of full scale."""
        table, (rows, cols) = self.table, self.table.cfa.shape
        down, across = (1 + 2 * -(-self._reach // period) for period in (rows, cols))  # periods of an area
        tile = np.tile(table.cfa, (down, across))
        values = table.black_level + np.hstack([share[tile] for share in shares]) * (table.white_level - table.black_level)
        plain = RawFrame("plain areas", np.rint(values).astype(np.uint16), table.black_level, table.white_level)
        middle = self._renderer.exact_outputs(plain)[:, down // 2 * rows :][:, :rows]
        areas = middle.reshape(len(table.outputs), rows, len(shares), across, cols)[:, :, :, across // 2]
        return np.asarray(areas.mean(axis=(1, 3)).T, np.float64)

    def signals(self, frame: RawFrame, grey: Grey) -> NDArray[np.float64]:
        """Return mean signal (channel), in DN above black and dark current, of a grey in a frame; InputFileError if it is
        clipped, too dark or not plain, or holds too little of a channel."""
        means, why = _measured(frame, self.table, grey.where)
        if why:
            raise InputFileError(f"{grey.name} {why}")
        return means

    def usable(self, frame: RawFrame, grey: Grey) -> bool:
        """Return whether the signals of a grey can be taken."""
        return not _measured(frame, self.table, grey.where)[1]

    def of_part(self, frame: RawFrame, where: tuple[slice, slice]) -> NDArray[np.float64]:
        """Return mean outputs of rows and columns of a frame as the sensor lies."""
        rows, cols = where
        margin = self._reach + max(self.table.cfa.shape)
        top, left = max(rows.start - margin, 0), max(cols.start - margin, 0)
        cut = _shading_corrected(frame, (slice(top, rows.stop + margin), slice(left, cols.stop + margin)))
        phase = ((frame.phase[0] + top) % self.table.cfa.shape[0], (frame.phase[1] + left) % self.table.cfa.shape[1])
        planes = self._renderer.exact_outputs(replace(cut, phase=phase))
        inside = planes[:, rows.start - top : rows.stop - top, cols.start - left : cols.stop - left]
        return np.asarray(inside.mean(axis=(1, 2)))


def _shading_corrected(frame: RawFrame, where: tuple[slice, slice]) -> RawFrame:
    """Return a part of a frame, its phase still that of the whole, without what channels differ by in their shading; what
    all of them lose is about the same there, and stays."""
    shading = frame.shading
    cut = None if shading is None else replace(shading, colour=None if shading.colour is None else shading.colour[where])
    return replace(replace(frame, values=frame.values[where], shading=cut).shading_corrected(), shading=None)


def _measured(frame: RawFrame, table: TransformTable, where: tuple[slice, slice]) -> tuple[NDArray[np.float64], str]:
    """Return mean signal (channel) in DN above black and dark current of a part of a frame, and why it is no grey, or ""."""
    values, means = _shading_corrected(frame, where).values, np.zeros(len(table.channels))
    clipped = float((values >= frame.white_level).mean())
    if clipped > MOST_CLIPPED:
        return means, f"is clipped in {clipped:.0%} of its pixels; give a darker grey"
    cfa = shifted_cfa(table.cfa, (frame.phase[0] + where[0].start, frame.phase[1] + where[1].start))
    channel = tiled(cfa, values.shape)
    top, reached = int(frame.values.max()), 0  # of how many channels the part has the frame's highest value
    for index, letter in enumerate(table.channels):
        seen = values[channel == index] - (frame.black_level + frame.dark)
        if seen.size < 2:
            return means, f"has too few pixels of channel {letter}; give a larger size"
        means[index] = seen.mean()
        if not means[index] > LEAST_CERTAINTY * seen.std() / np.sqrt(seen.size):
            if means[index] > DARK * (frame.white_level - frame.black_level):
                varies = seen.std() / means[index]
                return means, f"is not plain: channel {letter} varies by {varies:.0%}; give something of one colour"
            return means, f"is too dark: channel {letter} has {means[index]:.3g} DN; give a brighter grey"
        reached += bool((values[channel == index] == top).mean() > FLAT)
    if reached > 1:
        return means, f"is clipped at {top} DN, below the white level of {frame.white_level:g}; correct ‹white_level›"
    return means, ""


TIME_CONSTANT = 1.0  # s, in which log exposure and white go 63 % of the difference to those of a light that has changed


@dataclass(frozen=True)
class WhiteBalance:
    """Gains and adaptation that make the white of a scene neutral."""

    gains: NDArray[np.float64]  # (channel) of the signals, none below 1: what clips does so at the white level still
    adaptation: NDArray[np.float64]  # (3, 3) XYZ under D65 of a table's X, Y, Z, with the Y of white unchanged
    luminance: float  # Y of a grey without the gains / with them


def adaptation(white: Array) -> NDArray[np.float64]:
    """Return Bradford adaptation (3, 3) of outputs from a white (3)."""
    return np.asarray(adaptation_matrix(white, display_white()), np.float64)


def plain_balance(white: Array, channels: int) -> WhiteBalance:
    """Return the adaptation from a white (3) alone."""
    return WhiteBalance(np.ones(channels), adaptation(white), 1.0)


def balanced(frame: RawFrame, table: TransformTable, gains: Array) -> RawFrame:
    """Return a frame whose channels have been multiplied by their gains, up to the white level."""
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
    """Return, as `balanced`, patches (patch, tap) whose taps are of the channels `channel` (tap)."""
    if (gains == 1).all():
        return patches
    curves = _curves(patches.black_level + patches.dark, patches.white_level, tuple(gains.tolist()))
    return replace(patches, values=curves[channel[None], patches.values])


@functools.lru_cache(maxsize=8)
def _curves(zero: float, white_level: float, gains: tuple[float, ...]) -> NDArray[np.uint16]:
    """Return the value that each of all 16-bit values becomes in each channel (channel, value); from the white level on
    they stay."""
    every = np.arange(1 << 16)
    raised = np.rint((every - zero) * np.array(gains)[:, None] + zero)
    return np.where(every < white_level, np.clip(raised, 0, np.ceil(white_level)), every).astype(np.uint16)


class SteadyWhite:
    """White balance of each frame of a sequence in its order.

    The first frame's is its own, later ones follow exponentially, as the exposure does. Only past frames count.
    """

    def __init__(self, rate: Fraction) -> None:
        self._share = followed_share(rate)
        self._now: WhiteBalance | None = None

    def balance(self, wanted: WhiteBalance | None) -> WhiteBalance | None:
        """Return the balance of the next frame; one that asks for none leaves it where it was (None at the beginning)."""
        if wanted is not None:
            self._now = wanted if self._now is None else _between(self._now, wanted, self._share)
        return self._now


def followed_share(rate: Fraction) -> float:
    """Return the share of a difference that is followed from one frame to the next."""
    return 1 - math.exp(-1 / (float(rate) * TIME_CONSTANT))


def _between(now: WhiteBalance, wanted: WhiteBalance, share: float) -> WhiteBalance:
    gains = now.gains * (wanted.gains / now.gains) ** share
    matrix = now.adaptation + share * (wanted.adaptation - now.adaptation)
    return WhiteBalance(gains, matrix, now.luminance * (wanted.luminance / now.luminance) ** share)


GREY_LEVEL = 0.4  # of full scale, in the brightest channel: where tables have learned most
LARGEST_GAIN = 8.0  # of a channel: beyond, it is noise
SURFACES = 64  # measured reflectances that a table's colours under a light are corrected by
UNSURE = 1e-3  # of a surface: error of what a table shows of it, which a correction is not to amplify
DARKEST = 0.05  # of white: below, errors of surfaces count no more than there
MOST_GREEN = 0.03  # distance from the black bodies in CIE 1960 uv that no lamp for people has
SAME_WHITE = 5e-4  # distance in CIE 1960 uv of whites that are the same, as written with four digits
MOST_MISFIT = 0.12  # of the logarithms of channels; fluorescent and LED lamps reach half of it
NEAR_WHITE = 0.02  # distance of chromaticities u′v′ from which on two whites are different lights
COOLEST, WARMEST = 24_000.0, 1_700.0  # K: what a search ends with lies beyond them


@dataclass(frozen=True)
class SceneWhite:
    """A white, how frames are balanced for it, and the light that has it, as far as it is known."""

    balance: WhiteBalance
    light: CorrelatedLight
    modelled: bool  # whether the responsivities of the table's camera took part

    @property
    def plausible(self) -> bool:
        """Return whether lamps, daylight or shade may give this white."""
        return _is_plausible(self.light)

    def __str__(self) -> str:
        light = self.light
        x, y = light.xyz[:2] / light.xyz.sum()
        side = "green" if light.duv >= 0 else "pink"
        return f"x,y = {x:.4f},{y:.4f}, {light.kelvin:.0f} K, {abs(light.duv):.3f} in uv to the {side}"


class Whites:
    """Whites of scenes, by what a table makes of a grey under their light.

    Where the table knows its camera and the light it was trained under, the channels of a frame are first brought to the
    ratios that they have under that light: only then are the edges of grey things grey, and highlights that clip white.
    What the colours of surfaces still differ by is corrected by a matrix.
    """

    def __init__(self, table: TransformTable) -> None:
        self.table = table

    @functools.cached_property
    def grey(self) -> GreyRenderer:
        return GreyRenderer(self.table)

    @functools.cached_property
    def trained(self) -> NDArray[np.float64] | None:
        """Return the signals (channel) of a grey under the light of training; None of a table that does not say."""
        camera, light = self.table.camera, self.table.light
        if camera is None or light is None:
            return None
        return camera.signal_weights @ spectra.resample(light.radiance, light.wavelength, camera.wavelength)

    def of_neutral(self, neutral: Array) -> SceneWhite:
        """Return the white of which the channels have the signals `neutral` (channel), of any scale; InputFileError if the
        table makes no white of them."""
        if not (np.isfinite(neutral).all() and neutral.max() > 0):
            raise InputFileError("a white without light is none; give another ‹white›")
        camera = self.table.camera
        if camera is None:
            return self.of_xyz(self._shown(neutral))
        light = light_of_neutral(camera.signal_weights, camera.wavelength, neutral)
        return SceneWhite(self._balance(neutral, light), light, True)

    def of_light(self, name: str) -> SceneWhite:
        """Return the white of a named illuminant; RecipeError if it is unknown."""
        white, camera = spectra.white_point(name), self.table.camera
        if camera is None:
            return self.of_xyz(white)
        radiance = spectra.illuminant(name, camera.wavelength)
        light = CorrelatedLight(white, *temperature(white), 0.0, radiance)
        return SceneWhite(self._balance(camera.signal_weights @ radiance, light), light, True)

    def of_chromaticity(self, white: Array) -> SceneWhite:
        """Return the white of a scene of which no more is known than its XYZ (3): of the light of training if that has it,
        else of the black body or daylight, more or less green, that has it; where none has, pictures are adapted from it."""
        camera = self.table.camera
        if camera is None or np.linalg.norm(uv(white) - uv(self.table.white_point[:3])) < SAME_WHITE:
            return self.of_xyz(white)
        light = light_of_white(white, camera.wavelength)
        if not _is_plausible(light):
            return self.of_xyz(white)
        assert light.radiance is not None
        return SceneWhite(self._balance(camera.signal_weights @ light.radiance, light), light, True)

    def of_xyz(self, white: Array) -> SceneWhite:
        """Return the white of XYZ (3) as the table shows it."""
        return SceneWhite(plain_balance(white, len(self.table.channels)), light_of(white), False)

    def of_greys(self, frame: RawFrame, greys: Sequence[Grey]) -> SceneWhite:
        """Return the white of greys in a frame: that by which they have the least chroma, in squares of C*ab, all in all.
        InputFileError if one of them is clipped, too dark or not plain."""
        signals = np.array([self.grey.signals(frame, grey) for grey in greys])
        share = signals.mean(axis=1) / signals.mean(axis=1).max()
        weights = share ** (2 / 3) / share  # of what each says of the ratios: C*ab grows with the cube root of light
        made = self.of_neutral(weights @ signals)
        even = balanced(frame, self.table, made.balance.gains)
        whole = [number for number, grey in enumerate(greys) if self.grey.usable(even, grey)]  # gains may clip bright ones
        if not whole:
            return made
        shown = weights[whole] @ np.array([self.grey.of_part(even, greys[number].where) for number in whole])
        left = made.balance.adaptation @ _white(shown)  # of the white: what the table makes of these greys and of others
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
        """Return factors (channel), none below 1, that bring a neutral to that of training as far as they may."""
        if self.trained is None:
            return np.ones(len(neutral))
        seen = (neutral > 0) & (self.trained > 0)  # a channel of infrared may see nothing of a lamp
        ratio = np.where(seen, self.trained / np.where(seen, neutral, 1.0), 0.0)
        return np.clip(ratio / ratio.min(where=seen, initial=np.inf), 1.0, LARGEST_GAIN)

    def _shown(self, neutral: Array) -> NDArray[np.float64]:
        """Return the output (3) of the table for a grey."""
        return _white(self.grey.outputs_of(GREY_LEVEL * neutral[None] / neutral.max())[0])

    def _correction(self, radiance: Array, gains: Array) -> NDArray[np.float64]:
        """Return M (3, 3): XYZ under D65 from what the table, balanced and adapted, makes of measured surfaces under a light
        whose radiance (wavelength) is given on the camera's grid, by least squares in which white stays what it is."""
        camera = self.table.camera
        assert camera is not None
        surfaces = _surfaces(tuple(camera.wavelength))
        with_white = np.vstack([surfaces, np.ones(camera.wavelength.size)]) * radiance
        signals = with_white @ camera.signal_weights.T * gains
        shown = self.grey.outputs_of(signals * (GREY_LEVEL / signals[-1].max()))
        true = with_white @ spectra.xyz_weights(camera.wavelength).T
        ours, ideal = (of[:-1] / of[-1, 1] @ adaptation(_white(of[-1])).T for of in (shown, true))
        weights = 1.0 / np.maximum(ideal[:, 1:2], DARKEST)  # errors are seen relative to lightness
        through = display_white(), display_white()
        return np.asarray(fit_through(ours * weights, ideal * weights, *through, UNSURE**2), np.float64)


def _is_plausible(light: CorrelatedLight) -> bool:
    return abs(light.duv) <= MOST_GREEN and light.misfit <= MOST_MISFIT and WARMEST < light.kelvin < COOLEST


@functools.lru_cache(1)
def _surfaces(wavelength: tuple[float, ...]) -> Array:
    """Return measured reflectances (surface, wavelength), evenly taken from the library."""
    library = spectra.reflectance_library(np.array(wavelength))
    return np.asarray(library[np.linspace(0, len(library) - 1, SURFACES).round().astype(int)])


def _white(outputs: Array) -> NDArray[np.float64]:
    """Return outputs (3) that can be those of a white; InputFileError unless all are above zero."""
    if not (np.isfinite(outputs).all() and outputs.min() > 0):
        raise InputFileError("the table makes no white of this grey; is it the table of this camera?")
    return np.asarray(outputs, np.float64)


# ------------------------------------------------------------------------------------------------------- warnings


def far_from_training(asked: str, white: SceneWhite, table: TransformTable) -> str:
    """Return a warning if the table was probably not trained under a light that is `asked` for and not named, or nothing."""
    if (white.modelled and "," not in asked) or _alike(white.light.xyz, table.white_point):
        return ""
    x, y = table.white_point[:2] / table.white_point.sum()
    how = "colours are adapted from it alone; name the light, or train with it among the illuminants of SCENES.toml"
    if white.modelled:
        how = "taken for that of a black body or daylight; name a fluorescent or LED lamp, or give a grey's ROW,COL"
    return f"‹white› {asked} is far from the mean light of the training, x,y = {x:.4f},{y:.4f}: {how}"


def implausible(what: str, white: SceneWhite) -> str:
    """Return a warning of a white that no likely light gives, or nothing."""
    if white.plausible:
        return ""
    return (
        f"{what} is what no daylight, lamp or black body gives the table's camera ({white}); greys are made neutral by "
        "it, and no colour is corrected further; is it the table of this camera? give ‹white› otherwise"
    )


def unlike_stated(name: str, white: SceneWhite, stated: SceneWhite) -> str:
    """Return a warning if a file states quite another white than what is grey in its frame has, or nothing."""
    if _alike(white.light.xyz, stated.light.xyz):
        return ""
    return (
        f"{name}: its file states another white ({stated.light.kelvin:.0f} K) than its chart shows "
        f"({white.light.kelvin:.0f} K); the chart's is taken, and ‹white› camera would leave a cast"
    )


def _alike(one: Array, other: Array) -> bool:
    """Return whether two whites (XYZ) may be of one light."""
    difference = (uv(one) - uv(other)) * (1.0, 1.5)  # CIE 1976 u′v′
    return float(np.linalg.norm(difference)) <= NEAR_WHITE
