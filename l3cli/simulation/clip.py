"""Frames of a clip: a scene sampled where the camera looks, leaves laid on it, and where each pixel's content was a frame
before (docs/method.md#motion)."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.frames.scene import ChannelPicture, Scene
from l3cli.simulation import fields, leaves, sources
from l3cli.simulation.frame import SimulationRun
from l3cli.simulation.motion import Course, View, before, course
from l3cli.simulation.reflectances import DRAWN, palette, surfaces
from l3cli.simulation.sources import framed_size, resampled, scale_of, turned

Array = NDArray[np.float64]
Cube = NDArray[np.float32]  # (row, col, band)
FINE, MOST = 0.25, 256  # pixels between the samples that a leaf is drawn by, and most such samples in its radius
TEXTURE = 0.3  # standard deviation of the logarithm of a leaf's brightness
COVERED = 0.5  # share of a pixel from which on it shows a leaf
TINY = 1e-6  # pixels
UNSURE = 2  # pixels about an edge of a leaf whose content is of both sides: lens and demosaicking mix them


@dataclass(frozen=True)
class Sprite:
    """A leaf drawn about its place: how much of each sample it covers, and how bright it is there."""

    step: float  # pixels a sample
    cover: Cube  # (row, col, 2): share covered; share times brightness
    colour: NDArray[np.float32]  # (band) its reflectance, or signal


def sprites(course: Course, colours: NDArray[np.floating], seed: tuple[int, ...]) -> list[Sprite]:
    """Return the leaves of a course, of these colours (leaf, band)."""
    drawn = []
    for number, (radius, colour) in enumerate(zip(course.radius, colours, strict=True)):
        rng = np.random.default_rng([*seed, number])
        step = max(FINE, radius / MOST)
        half = int(np.ceil(radius / step)) + 2  # the rim is empty
        at = ((np.arange(2 * half) + 0.5 - half) * step).astype(np.float32)
        shape, angle, slimness = int(rng.integers(5)), rng.uniform(0, np.pi), rng.uniform(0.4, 1.0)
        mask = leaves.inside(shape, at[:, None], at[None], radius, angle, slimness).astype(np.float32)
        bright = np.exp(TEXTURE * fields.pink(rng, mask.shape, 1.2)).astype(np.float32)
        drawn.append(Sprite(step, np.stack([mask, mask * bright], axis=2), colour.astype(np.float32)))
    return drawn


def frame(canvas: Cube, scale: float, course: Course, things: list[Sprite], number: int) -> Cube:
    """Return the frame `number` (row, col, band) of a clip on a canvas (row, col, band) with `scale` pixels a sample."""
    moments = course.moments()
    total = np.zeros((*course.motion.size, canvas.shape[2]), np.float32)
    for moment in moments:
        view = course.view(number, moment)
        seen = sampled(canvas, view, course.motion.size, (0.0, 0.0), scale)
        places = course.leaves(number, moment)
        for thing, place in reversed(list(zip(things, places, strict=True))):
            part, cover = _part(seen, thing.cover, thing.step, view, place)
            part *= 1 - cover[..., :1]
            part += np.minimum(cover[..., 1:] * thing.colour, cover[..., :1])  # no brighter than a perfect white
        total += seen
    return total if len(moments) == 1 else total / np.float32(len(moments))


def sampled(
    cube: Cube, view: View, size: tuple[int, int], place: tuple[float, float], scale: float, top: tuple[int, int] = (0, 0),
    window: tuple[int, int] | None = None,
) -> Cube:  # fmt: skip
    """Return a `window` (rows, cols) from the pixel `top` on of a frame of `size` that shows a cube (row, col, band) whose
    middle is at `place`, with `scale` pixels a sample: each pixel is the mean over its area of the cube."""
    down, across = (
        _resampling(
            length=cube.shape[axis],
            pixels=(window or size)[axis],
            first=(view.centre[axis] + (top[axis] - size[axis] / 2) / view.zoom - place[axis]) / scale
            + cube.shape[axis] / 2,
            step=1.0 / (view.zoom * scale),
        )
        for axis in (0, 1)
    )
    return resampled(cube, down, across)


def _resampling(length: int, pixels: int, first: float, step: float) -> Any:
    """Return sparse M (pixel, sample): means over first + pixel · step … + step of straight lines between samples, which lie
    at 0.5, 1.5, …; beyond the ends their values go on. Exact: what moves by part of a pixel keeps its light."""
    from scipy.sparse import csr_array

    start = first + step * np.arange(pixels)[:, None]
    knots = np.floor(start - 1.5).astype(int) + np.arange(int(np.ceil(step)) + 4)
    centre = knots + 0.5
    weight = (_filled(start + step - centre) - _filled(start - centre)) / step
    row = np.broadcast_to(np.arange(pixels)[:, None], knots.shape)
    column = np.clip(knots, 0, length - 1)
    return csr_array((weight.astype(np.float32).ravel(), (row.ravel(), column.ravel())), shape=(pixels, length))


def _filled(until: Array) -> Array:
    """Return integral up to there of the triangle that falls from 1 at 0 to 0 at ±1."""
    inner = np.clip(until, -1.0, 1.0)
    return np.where(inner < 0, 0.5 * (1 + inner) ** 2, 1 - 0.5 * (1 - inner) ** 2)


def _part(picture: NDArray[Any], cover: Cube, step: float, view: View, place: Array) -> tuple[NDArray[Any], Cube]:
    """Return the part of a frame (row, col, …) that a leaf may show in, and its `cover` (row, col, band), of `step` pixels
    a sample, in the pixels of that part; both may be empty."""
    size = (picture.shape[0], picture.shape[1])
    half = np.array(cover.shape[:2]) * step / 2
    middle = np.array(size) / 2
    low = np.clip(np.floor((place - half - view.centre) * view.zoom + middle) - 1, 0, size).astype(int)
    high = np.clip(np.ceil((place + half - view.centre) * view.zoom + middle) + 1, 0, size).astype(int)
    if (high <= low).any():
        return picture[:0, :0], cover[:0, :0]
    (top, left), (rows, cols) = low.tolist(), (high - low).tolist()
    at = (float(place[0]), float(place[1]))
    part = picture[top : top + rows, left : left + cols]
    return part, sampled(cover, view, size, at, step, (top, left), (rows, cols))


# ------------------------------------------------------------------------------------------------------ known motion


def motion_between(course: Course, things: list[Sprite], number: int) -> NDArray[np.float32]:
    """Return the motion of frame `number` since the frame before (3, row, col): pixels down, pixels right, and 1 where
    the same thing was seen then and its edge is not near. Of the first frame all is 0."""
    size = course.motion.size
    if number == 0:
        return np.zeros((3, *size), np.float32)
    view, earlier = course.view(number), course.view(number - 1)
    top, was = (_shown(course, things, each) for each in (number, number - 1))
    velocity = np.vstack([course.velocity, np.zeros(2)])  # -1: the scene itself
    source = before(view, earlier, size, velocity[top].transpose(2, 0, 1))
    pixel = np.indices(size)
    nearest = np.rint(source).astype(int)
    inside = np.logical_and.reduce(
        [(at > -TINY) & (at < length - 1 + TINY) for at, length in zip(source, size, strict=True)]
    )
    nearest = np.stack([np.clip(at, 0, length - 1) for at, length in zip(nearest, size, strict=True)])
    seen = inside & (was[nearest[0], nearest[1]] == top) & _sure(top) & _sure(was)[nearest[0], nearest[1]]
    return np.concatenate([pixel - source, seen[None]]).astype(np.float32)


def _shown(course: Course, things: list[Sprite], number: int) -> NDArray[np.intp]:
    """Return the leaf that each pixel (row, col) of a frame shows, -1 for the scene itself."""
    view, shown = course.view(number), np.full(course.motion.size, -1)
    for leaf, place in reversed(list(enumerate(course.leaves(number)))):
        part, cover = _part(shown, things[leaf].cover[..., :1], things[leaf].step, view, place)
        part[cover[..., 0] > COVERED] = leaf
    return shown


def _sure(shown: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return the mask (row, col) of pixels near which nothing else is shown."""
    from scipy.ndimage import maximum_filter, minimum_filter

    side = 2 * UNSURE + 1
    return np.asarray(maximum_filter(shown, side) == minimum_filter(shown, side))


# ------------------------------------------------------------------------------------------------- clips of a run

MOVING, LEAVES, COLOURS = 1, 2, 3  # parts of a seed: course, shapes, and colours of the leaves


def clip_of(
    scene: Scene | ChannelPicture, wanted: sources.WantedScene, run: SimulationRun
) -> Callable[[int], Scene | ChannelPicture]:
    """Return the scene, as it was drawn or read, in each frame of its clip; ValueError if the camera moves beyond it."""
    framing = wanted.source
    samples = scene.signal if isinstance(scene, ChannelPicture) else scene.reflectance
    framed_size((samples.shape[0], samples.shape[1]), framing, run.camera)
    if isinstance(scene, Scene) and scene.ignored is not None:
        if turned(scene.ignored[..., None].astype(np.float32), framing).any():
            raise ValueError("pixels without data would move through its clip; crop them away")
        scene = replace(scene, ignored=None)
    canvas = np.ascontiguousarray(turned(samples, framing))
    scale = scale_of(framing, run.camera, canvas.shape[1]) or 1.0
    course = _course(wanted, run)
    things = sprites(course, _colours(scene, len(course.radius), wanted, run), _seed(wanted, run, LEAVES))

    def moment(number: int) -> Scene | ChannelPicture:
        seen = frame(canvas, scale, course, things, number)
        return replace(scene, signal=seen) if isinstance(scene, ChannelPicture) else replace(scene, reflectance=seen)

    return moment


def known_motion(wanted: sources.WantedScene, run: SimulationRun) -> Callable[[int], NDArray[np.float32]]:
    """Return a function of the motion of each frame of a clip since the one before, as `motion_between` gives it."""
    course = _course(wanted, run)
    things = sprites(course, np.zeros((len(course.radius), 1)), _seed(wanted, run, LEAVES))
    return lambda number: motion_between(course, things, number)


def _course(wanted: sources.WantedScene, run: SimulationRun) -> Course:
    motion = wanted.source.motion
    assert motion is not None
    return course(motion, _seed(wanted, run, MOVING))


def _colours(
    scene: Scene | ChannelPicture, count: int, wanted: sources.WantedScene, run: SimulationRun
) -> NDArray[np.float32]:
    """Return reflectances or signals (leaf, band) of the leaves."""
    rng = np.random.default_rng(_seed(wanted, run, COLOURS))
    if isinstance(scene, ChannelPicture):
        return rng.uniform(0.05, 0.9, (count, scene.signal.shape[2])).astype(np.float32)
    if count == 0:
        return np.zeros((0, scene.wavelength.size), np.float32)
    every = np.union1d(DRAWN, scene.wavelength)
    materials = palette(rng, surfaces(tuple(every)))[:, np.isin(every, scene.wavelength)]
    return materials[rng.integers(len(materials), size=count)].astype(np.float32)


def _seed(wanted: sources.WantedScene, run: SimulationRun, part: int) -> tuple[int, ...]:
    return (run.seed, getattr(wanted.source, "seed", 0), wanted.number, part)
