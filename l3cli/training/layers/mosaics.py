"""Cut training mosaics from frames, and render them with the existing layers (docs/method.md#layers).

A mosaic is a piece of a training frame, scaled to a random level and simulated with and without noise. The rendered mosaics
are the training data of the next layer.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.layers import PLANE_TOP, PLANES, MosaicLayer, PlaneLayer
from l3cli.artifacts.training_set import TrainingFrame, TrainingPair
from l3cli.classes.decide import labels as classes_of
from l3cli.classes.level import unclipped_level
from l3cli.classes.planes import COARSE, FixedPoint, coarse, refined_fixed_point
from l3cli.classes.refinement import label_planes
from l3cli.classes.statistics import mosaic_statistics, truncation
from l3cli.classes.structure import BORDER_PIXELS
from l3cli.classes.windows import Integers, neighbourhoods
from l3cli.training.lines import LineNoise
from l3cli.training.patches import even_places, expose_patches, levels_at, without_colour
from l3cli.training.recipe import LearningRecipe
from l3cli.training.sums import runs_of
from l3cli.training.symmetry import HALF_TURN, Allowed, orientations_of_scenes

Floats = NDArray[np.float32]
LARGEST_SIDE = 156  # largest side, in pixels, of a mosaic and of the area that determines its mean level
SHEET = 1 << 17  # number of pixels per batch, large enough to make the overhead per batch negligible


@dataclass(frozen=True)
class Mosaics:
    """Mosaics of equal size, stacked vertically in one array. Each mosaic begins at CFA site (0, 0)."""

    count: int  # number of mosaics
    values: NDArray[np.uint16]  # (row, col) raw values in DN, with noise
    clean: Floats | None  # (row, col) noise-free values in DN, clipped at the white level; None if `values` are noise-free
    target: Floats  # (output, row, col) ideal outputs, in the output unit of the table
    usable: NDArray[np.bool_] | None = None  # (row, col) mask of the pixels to train on, or None for all pixels

    @classmethod
    def joined(cls, parts: list["Mosaics"]) -> "Mosaics":
        """Stack mosaics of equal width into one array."""
        values, target = (np.concatenate([getattr(part, name) for part in parts], axis=-2) for name in ("values", "target"))
        clean = [part.clean for part in parts if part.clean is not None]
        usable = None
        if any(part.usable is not None for part in parts):
            masks = [np.ones(part.values.shape, bool) if part.usable is None else part.usable for part in parts]
            usable = np.concatenate(masks)
        return cls(sum(part.count for part in parts), values, np.concatenate(clean) if clean else None, target, usable)


@dataclass(frozen=True)
class Exposed:
    """Settings for cutting mosaics from frames and exposing them."""

    camera: CameraModel
    recipe: LearningRecipe
    dark: float  # dark signal at the mean exposure time of the training frames, in DN
    achromatic: float  # fraction of the mosaics in which all colours are replaced with greys
    noisy: bool  # whether to add the camera's noise
    inner: int  # side of the square of training pixels; smaller if the frame is too small
    margin: int  # width, in pixels, of the border around this square that the layers also read

    def shape(self, frame: tuple[int, int]) -> tuple[int, int]:
        """Return the shape (rows, cols) of the mosaics to cut from a frame of shape `frame`.

        Both sides are multiples of the CFA period, unless the frame is smaller than one period.
        """
        most = min(*frame, LARGEST_SIDE)
        wanted = min(self.inner + 2 * self.margin, most)
        rows, cols = (min(-(-wanted // period), most // period) * period or most for period in self.camera.cfa.shape)
        return rows, cols


def mosaics_of(frame: TrainingPair, count: int, exposed: Exposed, rng: np.random.Generator) -> Iterator[Mosaics]:
    """Yield mosaics from random places in a frame.

    Mosaics from a simulated frame have random levels and orientations. A fraction of them, at the end, are achromatic.
    Mosaics from a real pair are unchanged pieces of the frame, because a real frame's noise cannot be separated from its
    scene. A frame that is not larger than the margins yields no mosaics.

    Parameters
    ----------
    frame : TrainingPair
        Simulated frame, or real pair.
    count : int
        Number of mosaics.
    exposed : Exposed
        Settings for cutting and exposing mosaics.
    rng : numpy.random.Generator
        Random number generator.

    Yields
    ------
    Mosaics
        A single mosaic.
    """
    camera, shape = exposed.camera, exposed.shape(frame.raw.shape)
    if min(shape) <= 2 * exposed.margin:
        return
    if not isinstance(frame, TrainingFrame):
        yield from (_piece_of_pair(frame, shape, camera, rng) for _ in range(count))
        return
    colourless = 0 if frame.light is None else round(exposed.achromatic * count)
    yield from _shown(frame, count - colourless, shape, exposed, rng)
    if colourless:
        yield from _shown(without_colour(frame, camera), colourless, shape, exposed, rng)


def _shown(
    frame: TrainingFrame, count: int, shape: tuple[int, int], exposed: Exposed, rng: np.random.Generator
) -> Iterator[Mosaics]:
    """Yield `count` random parts of a simulated frame, in random orientations and scaled to random levels."""
    camera = exposed.camera
    channel = camera.channel_map(shape)
    gains = (camera.channel_gains / camera.full_scale).astype(np.float32)
    mean = np.tensordot(gains / np.float32(gains.size), frame.electrons, 1)[None]
    usable = _usable(frame, exposed.margin)
    lines = LineNoise.of(camera, exposed.dark)
    places = even_places(count, 3, rng)
    levels = levels_at(exposed.recipe, places[:, 2])
    for place, level in zip(places[:, :2].tolist(), levels.tolist(), strict=True):
        part, piece = _drawn_turn(frame.raw.shape, shape, place, orientations_of_scenes(camera), rng)
        scale = np.float32(level / max(float(_turned(mean, part).mean()), 1e-3) if exposed.recipe.rescale else 1)
        seen = np.take_along_axis(_turned(frame.electrons, piece), channel[None].astype(np.intp), 0)[0]
        mosaic = seen * (gains * scale)[channel]
        clean = np.minimum(mosaic, 1.0) * np.float32(camera.white_level - camera.black_level) + np.float32(
            camera.black_level
        )
        values = np.rint(clean)
        if exposed.noisy:
            offsets = None if lines is None else lines.drawn(shape, rng)
            values = expose_patches(mosaic, camera, rng, None, exposed.dark, channel, offsets)
        target = _turned(frame.target, piece) * np.float32(scale * frame.exposure / camera.output_unit)
        # At randomly lowered levels, rounding to whole DN acts as noise, so the unrounded values are kept too.
        as_rounded = not (exposed.noisy or exposed.recipe.rescale)
        part_usable = None if usable is None else _turned(usable, piece)[0]
        yield Mosaics(1, values.astype(np.uint16), None if as_rounded else clean, target, part_usable)


def _usable(frame: TrainingFrame, margin: int) -> NDArray[np.bool_] | None:
    """Return a mask of the pixels at a distance of more than `margin` from any ignored pixel: (1, row, col).

    Return None if all pixels are usable.
    """
    if frame.ignored is None:
        return None
    return np.asarray(maximum_filter(frame.ignored.mask, 2 * margin + 1, mode="nearest") == 0)[None]


def sheets_of(mosaics: Iterable[Mosaics], period: int) -> Iterator[Mosaics]:
    """Stack successive mosaics of equal size into batches of up to `SHEET` pixels.

    `period` is the height of the CFA period. If a mosaic's height is not a multiple of it, the mosaic stays alone.
    """
    parts: list[Mosaics] = []
    for each in mosaics:
        if parts and (
            (len(parts) + 1) * each.values.size > SHEET
            or parts[0].values.shape != each.values.shape
            or each.values.shape[0] % period
        ):
            yield Mosaics.joined(parts)
            parts = []
        parts.append(each)
    if parts:
        yield Mosaics.joined(parts)


def _piece_of_pair(pair: TrainingPair, shape: tuple[int, int], camera: CameraModel, rng: np.random.Generator) -> Mosaics:
    starts = [
        int(rng.integers((length - side) // period + 1)) * period
        for length, side, period in zip(pair.raw.shape, shape, camera.cfa.shape, strict=True)
    ]
    rows, cols = (slice(start, start + side) for start, side in zip(starts, shape, strict=True))
    values = pair.raw[rows, cols]
    target = pair.target[:, rows, cols] * np.float32(pair.exposure / camera.output_unit)
    return Mosaics(1, values, np.minimum(values.astype(np.float32), np.float32(camera.white_level)), target)


# (number of quarter turns, True if the frame is mirrored, rows to cut out afterwards, columns to cut out afterwards)
Turn = tuple[int, bool, slice, slice]


def _drawn_turn(
    frame: tuple[int, ...], shape: tuple[int, int], place: list[float], allowed: Allowed, rng: np.random.Generator
) -> tuple[Turn, Turn]:
    """Draw a random orientation for a frame, and locate a mosaic and its surroundings in the turned frame.

    Parameters
    ----------
    frame, shape : tuple of int
        Shapes (rows, cols) of the frame and the mosaic.
    place : list of float
        Position of the mosaic along each axis of the turned frame, from 0 to 1.
    allowed : tuple of int
        Orientations to draw from.
    rng : numpy.random.Generator
        Random number generator.

    Returns
    -------
    part : Turn
        A larger area around the mosaic. The mosaic is scaled so that this area has the drawn level.
    piece : Turn
        The mosaic.
    """
    turns, mirrored = int(rng.integers(4)), bool(rng.integers(2))
    if allowed == HALF_TURN:
        turns, mirrored = 2 * (turns % 2), False
    parts, pieces = [], []
    for length, side, share in zip(frame[::-1] if turns % 2 else frame, shape, place, strict=True):
        most = min(length, LARGEST_SIDE)
        piece = int(share * (length - side + 1))
        part = min(max(piece - (most - side) // 2, 0), length - most)
        parts.append(slice(part, part + most))
        pieces.append(slice(piece, piece + side))
    return (turns, mirrored, parts[0], parts[1]), (turns, mirrored, pieces[0], pieces[1])


def _turned(planes: NDArray, turn: Turn) -> NDArray:
    turns, mirrored, rows, cols = turn
    turned = np.rot90(planes, turns, (1, 2))
    return (turned[:, :, ::-1] if mirrored else turned)[:, rows, cols]


AT_ONCE = 1 << 10  # number of pixels to process together, so that their windows fit into the CPU cache
DARKEST_LEVEL = 1e-4  # lower limit of a pixel's brightness in its training weight, as a fraction of full scale


@dataclass(frozen=True)
class Seen:
    """Mosaics rendered by one or more layers, without the borders where windows would extend beyond the mosaic."""

    count: int  # number of stacked mosaics
    target: Floats  # (row, col, output) ideal outputs
    label: Integers  # (row, col) class in the first layer
    brightness: Floats  # (row, col) mean signal of all channels, corrected for clipping, as a fraction of full scale
    noisy: NDArray[np.int32]  # (plane, row, col) planes with noise, in plane steps
    # (plane, row, col) noise-free planes, in plane steps, rendered with the classes of the noisy pixels
    clean: Floats | None
    # The next two fields are None unless later layers correct the first layer's outputs.
    missing: Floats | None = None  # (row, col, output) ideal outputs minus the first layer's noise-free outputs
    spread: Floats | None = None  # (row, col, output) noise in the first layer's outputs
    usable: NDArray[np.bool_] | None = None  # (row, col) mask of the pixels to train on, or None for all pixels

    @property
    def light(self) -> Floats:
        """The noise-free planes, (plane, row, col)."""
        return self.noisy.astype(np.float32) if self.clean is None else self.clean

    def inner_pixels(self, margin: int) -> Integers:
        """Return the flat indices of the training pixels, excluding `margin` pixels along each mosaic's edges."""
        inner = within(np.arange(self.label.size).reshape(self.label.shape), self.count, margin).ravel()
        return inner if self.usable is None else inner[self.usable.ravel()[inner]]


def within(planes: NDArray, count: int, margin: int) -> NDArray:
    """Crop `margin` pixels from each side of `count` vertically stacked mosaics (…, row, col)."""
    rows, cols = planes.shape[-2] // count, planes.shape[-1]
    mosaics = planes.reshape(*planes.shape[:-2], count, rows, cols)[..., margin : rows - margin, margin : cols - margin]
    return mosaics.reshape(*planes.shape[:-2], count * mosaics.shape[-2], mosaics.shape[-1])


def margin_of(side: int) -> int:
    """Return the margin, in pixels, that filtering and classification with windows of `side` pixels need."""
    return max(BORDER_PIXELS, side // 2)


class FirstLayer:
    """Renders mosaics with the first layer in fixed point.

    Parameters
    ----------
    camera : CameraModel
        Camera for which the table is trained.
    rule : ClassRule
        Class rule of the first layer.
    fixed : FixedPoint
        Fixed-point transforms of the first layer.
    outputs : MosaicLayer, optional
        The first layer, needed only if later layers correct its outputs. The outputs are then also computed in floating
        point.
    """

    def __init__(self, camera: CameraModel, rule: ClassRule, fixed: FixedPoint, outputs: MosaicLayer | None = None) -> None:
        self.camera, self.rule, self.fixed = camera, rule, fixed
        self._neighbours = neighbourhoods(camera.cfa, rule.patch, len(camera.channels))
        exact = None
        if outputs is not None:
            weights = np.ascontiguousarray(outputs.weights, np.float64) / (camera.white_level - camera.black_level)
            exact = weights, outputs.intercept - camera.black_level * weights.sum(axis=-1)
        self._apply = _Transforms(fixed, exact)

    def see(self, mosaics: Mosaics) -> Seen:
        """Classify the pixels of mosaics, and render planes with and without noise."""
        camera, rule, count, margin = self.camera, self.rule, mosaics.count, self.rule.radius
        statistics = mosaic_statistics(mosaics.values, rule, self._neighbours, camera.cfa, (0, 0))
        mean = (statistics.sums / self._neighbours.count[statistics.site]).mean(axis=-1) * 2**rule.shift
        share = (mean + truncation(rule.shift) - camera.black_level) / (camera.white_level - camera.black_level)
        brightness = np.maximum(unclipped_level(share, camera.sensitivity), DARKEST_LEVEL).astype(np.float32)
        label = within(rule.on_site(classes_of(rule, statistics), statistics.site), count, margin)
        clean = None if mosaics.clean is None else mosaics.clean[None]
        noisy, clean, made = self._apply(mosaics.values[None], clean, rule.patch, count, label)
        target = np.moveaxis(within(mosaics.target, count, margin), 0, -1)
        missing = target - made[-1] if made.size else None
        spread = made[0] - made[-1] if made.size and len(made) > 1 else None
        usable = None if mosaics.usable is None else within(mosaics.usable, count, margin)
        return Seen(count, target, label, within(brightness, count, margin), noisy, clean, missing, spread, usable)


class PlaneStage:
    """Renders mosaics in fixed point with any refinement layer except the last."""

    def __init__(self, layer: PlaneLayer, first: ClassRule, basis: NDArray[np.float64]) -> None:
        self.layer, self.first = layer, first
        self._apply = _Transforms(refined_fixed_point(layer, basis))

    def see(self, seen: Seen) -> Seen:
        """Refine the previous layer's planes, with and without noise, and crop the margin."""
        count, margin = seen.count, margin_of(self.layer.side)
        label = within(label_planes(seen.noisy, seen.label, self.layer.rule, self.first), count, margin)
        edge = margin - self.layer.radius
        clean = None if seen.clean is None else within(seen.clean / np.float32(2**COARSE), count, edge)
        noisy, clean, _ = self._apply(within(coarse(seen.noisy), count, edge), clean, self.layer.side, count, label)
        return replace(
            seen,
            target=np.moveaxis(within(np.moveaxis(seen.target, -1, 0), count, margin), 0, -1),
            label=within(seen.label, count, margin),
            brightness=within(seen.brightness, count, margin),
            noisy=noisy,
            clean=clean,
            usable=None if seen.usable is None else within(seen.usable, count, margin),
        )


class _Transforms:
    """Applies a layer's fixed-point transforms and, optionally, its floating-point transforms."""

    def __init__(self, fixed: FixedPoint, exact: tuple[NDArray, NDArray] | None = None) -> None:
        self.fixed, weights, self._intercept = fixed, fixed.weights, fixed.intercept
        if exact is not None:
            weights, self._intercept = (
                np.concatenate(each, axis=1) for each in ((weights, exact[0]), (self._intercept, exact[1]))
            )
        # The strides of an array can affect how products are rounded, and pickling does not preserve all strides. With
        # contiguous arrays, every process computes the same bytes.
        self._weights = list(np.ascontiguousarray(np.swapaxes(weights, 1, 2), np.float64))

    def __call__(
        self, noisy: NDArray, clean: NDArray | None, side: int, count: int, label: Integers
    ) -> tuple[NDArray[np.int32], Floats | None, Floats]:
        """Filter a stack of mosaics with the transform of each pixel's class.

        Parameters
        ----------
        noisy : ndarray, (input, row, col)
            Raw values or planes with noise: integers small enough for exact sums in float64.
        clean : ndarray or None, (input, row, col)
            Raw values or planes without noise.
        side : int
            Side of the windows, in pixels.
        count : int
            Number of vertically stacked mosaics.
        label : ndarray, (row, col)
            Class of each pixel.

        Returns
        -------
        planes : ndarray, (plane, row, col)
            Integer planes from `noisy`, computed with the fixed-point transforms.
        clean_planes : ndarray or None, (plane, row, col)
            Planes from `clean`, computed with the same transforms but without rounding. None if `clean` is None.
        outputs : ndarray, (source, row, col, output)
            Results of the floating-point transforms for `noisy` and, if it is not None, `clean`. The last axis is empty if
            there are no floating-point transforms.
        """
        _, rows, cols = noisy.shape
        reach = np.arange(side) - side // 2
        offset = ((np.arange(len(noisy))[:, None, None] * rows + reach[:, None]) * cols + reach).reshape(-1)
        sources = [each.astype(np.float64).reshape(-1) for each in (noisy, clean) if each is not None]
        flat = label.reshape(-1)
        order = np.argsort(flat.astype(np.min_scalar_type(len(self._weights))), kind="stable")
        place = within(np.arange(rows * cols).reshape(rows, cols), count, side // 2).reshape(-1)[order]
        flat = flat[order]
        sums = np.empty((len(sources), flat.size, self._intercept.shape[1]))
        taps, windows = np.empty((AT_ONCE, offset.size), np.intp), np.empty((AT_ONCE, offset.size))
        for first in range(0, flat.size, AT_ONCE):
            part = slice(first, first + AT_ONCE)
            chosen = np.add(place[part, None], offset, out=taps[: flat.size - first])
            runs = [(self._weights[index], slice(start, stop)) for index, start, stop in runs_of(flat[part])]
            for source, made in zip(sources, sums[:, part], strict=True):
                source.take(chosen, out=windows[: len(chosen)], mode="clip")  # the default "raise" would buffer `out`
                for weights, run in runs:
                    np.dot(windows[run], weights, out=made[run])
        sums += self._intercept[flat]
        planes = np.empty((PLANES, flat.size), np.int32)
        planes[:, order] = self.fixed.planes(sums[0, :, :PLANES].T.astype(np.int64), flat)
        made = np.empty((len(sums), flat.size, sums.shape[2] - PLANES), np.float32)
        made[:, order] = sums[..., PLANES:]
        planes, made = planes.reshape(PLANES, *label.shape), made.reshape(len(sums), *label.shape, -1)
        if clean is None:
            return planes, None, made
        light = np.empty((PLANES, flat.size), np.float32)
        scaled = sums[1, :, :PLANES].T.astype(np.float32) * (2.0**-self.fixed.fraction).astype(np.float32)[flat]
        light[:, order] = np.clip(scaled, -PLANE_TOP, PLANE_TOP)
        return planes, light.reshape(PLANES, *label.shape), made
