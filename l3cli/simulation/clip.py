"""Simulated video clips, in which the camera and dead leaves move over a scene (docs/method.md#motion).

This module renders the frames of a clip and computes each pixel's true motion since the previous frame.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.sparse import csr_array

from l3cli.frames.scene import ChannelPicture, Scene
from l3cli.simulation import fields, leaves, sources
from l3cli.simulation.frame import SimulationRun
from l3cli.simulation.motion import Course, View, before, course
from l3cli.simulation.reflectances import DRAWN, palette, surfaces
from l3cli.simulation.sources import framed_size, resampled, scale_of, turned

Array = NDArray[np.float64]
Cube = NDArray[np.float32]  # (row, col, band)
FINEST_STEP = 0.25  # finest sampling interval of leaves, in pixels
MAX_RADIUS_SAMPLES = 256  # coarser sampling of larger leaves limits memory use
TEXTURE_CONTRAST = 0.3  # standard deviation of ln(brightness) within a leaf
COVERED = 0.5  # a leaf that covers more than this fraction of a pixel is the object that the pixel shows
ROUNDING_PIXELS = 1e-6  # tolerance for rounding errors at the frame border
EDGE_MARGIN = 2  # pixels; closer to an edge, lens blur and demosaicking mix both sides


@dataclass(frozen=True)
class Sprite:
    """Coverage and brightness of a moving leaf, sampled on a grid around its centre."""

    step: float  # distance between two samples, in pixels
    cover: Cube  # (row, col, 2), covered fraction of each sample, and covered fraction × relative brightness
    colour: NDArray[np.float32]  # (band,), reflectance or signal


def sprites(course: Course, colours: NDArray[np.floating], seed: tuple[int, ...]) -> list[Sprite]:
    """Draw the shapes and textures of the moving leaves of a clip.

    Parameters
    ----------
    course : Course
        Motion of the clip, including the radii of the leaves.
    colours : ndarray, (leaf, band)
        Reflectance or signal of each leaf.
    seed : tuple of int
        Seed. Each leaf has its own random generator, so its appearance does not depend on the other leaves.

    Returns
    -------
    list of Sprite
        One sprite per leaf, in the order of the leaves.
    """
    drawn = []
    for number, (radius, colour) in enumerate(zip(course.radius, colours, strict=True)):
        rng = np.random.default_rng([*seed, number])
        step = max(FINEST_STEP, radius / MAX_RADIUS_SAMPLES)
        half = int(np.ceil(radius / step)) + 2  # with a margin of two empty samples
        at = ((np.arange(2 * half) + 0.5 - half) * step).astype(np.float32)
        shape, angle, slimness = int(rng.integers(5)), rng.uniform(0, np.pi), rng.uniform(0.4, 1.0)
        mask = leaves.inside(shape, at[:, None], at[None], radius, angle, slimness).astype(np.float32)
        bright = np.exp(TEXTURE_CONTRAST * fields.pink(rng, mask.shape, 1.2)).astype(np.float32)
        drawn.append(Sprite(step, np.stack([mask, mask * bright], axis=2), colour.astype(np.float32)))
    return drawn


def frame(canvas: Cube, scale: float, course: Course, things: list[Sprite], number: int) -> Cube:
    """Render one frame of a clip, averaged over the exposure time.

    Parameters
    ----------
    canvas : ndarray, (row, col, band)
        The scene over which the camera moves.
    scale : float
        Distance between two samples of the canvas, in pixels of a frame without zoom.
    course : Course
        Motion of the camera and of the leaves.
    things : list of Sprite
        The leaves from front to back.
    number : int
        Frame number.

    Returns
    -------
    ndarray, (row, col, band)
        The part of the scene in the frame, partly covered by leaves.
    """
    moments = course.moments()
    total = np.zeros((*course.motion.size, canvas.shape[2]), np.float32)
    for moment in moments:
        view = course.view(number, moment)
        seen = sampled(canvas, view, course.motion.size, (0.0, 0.0), scale)
        places = course.leaves(number, moment)
        for thing, place in reversed(list(zip(things, places, strict=True))):
            part, cover = _part(seen, thing.cover, thing.step, view, place)
            part *= 1 - cover[..., :1]
            part += np.minimum(cover[..., 1:] * thing.colour, cover[..., :1])  # clips the leaf's reflectance to 1
        total += seen
    return total if len(moments) == 1 else total / np.float32(len(moments))


def sampled(
    cube: Cube, view: View, size: tuple[int, int], place: tuple[float, float], scale: float, top: tuple[int, int] = (0, 0),
    window: tuple[int, int] | None = None,
) -> Cube:  # fmt: skip
    """Resample a cube to the pixels of a frame by averaging over each pixel's area.

    Parameters
    ----------
    cube : ndarray, (row, col, band)
        Samples of the scene or of a leaf.
    view : View
        Position and zoom of the camera.
    size : tuple of int
        Rows and columns of the whole frame.
    place : tuple of float
        Position of the cube's centre (down, across), in pixels of a frame without zoom.
    scale : float
        Distance between two samples of the cube, in pixels of a frame without zoom.
    top : tuple of int
        Row and column of the first pixel to compute.
    window : tuple of int, optional
        Numbers of rows and columns to compute. [default: the whole frame]

    Returns
    -------
    ndarray, (row, col, band)
        The resampled cube.
    """
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
    """Return the sparse matrix (pixel, sample) that averages a line of samples over the extent of each pixel.

    Pixel n extends from first + n · step to first + (n + 1) · step. The samples are at 0.5, 1.5, … with linear interpolation
    between them, and constant values beyond the first and the last sample. The integral over a pixel is exact, so a small
    object keeps its total brightness when it moves by a fraction of a pixel.
    """
    start = first + step * np.arange(pixels)[:, None]
    knots = np.floor(start - 1.5).astype(int) + np.arange(int(np.ceil(step)) + 4)
    centre = knots + 0.5
    weight = (_filled(start + step - centre) - _filled(start - centre)) / step
    row = np.broadcast_to(np.arange(pixels)[:, None], knots.shape)
    column = np.clip(knots, 0, length - 1)
    return csr_array((weight.astype(np.float32).ravel(), (row.ravel(), column.ravel())), shape=(pixels, length))


def _filled(until: Array) -> Array:
    """Integrate a triangle with the peak 1 at 0 and zeros at ±1, from −1 to `until`."""
    inner = np.clip(until, -1.0, 1.0)
    return np.where(inner < 0, 0.5 * (1 + inner) ** 2, 1 - 0.5 * (1 - inner) ** 2)


def _part(picture: NDArray[Any], cover: Cube, step: float, view: View, place: Array) -> tuple[NDArray[Any], Cube]:
    """Crop a frame to the area that a leaf can cover, and resample the leaf to the pixels of this area.

    Parameters
    ----------
    picture : ndarray, (row, col, …)
        The frame.
    cover : ndarray, (row, col, band)
        Coverage of the leaf.
    step : float
        Distance between two samples of `cover`, in pixels.
    view : View
        Position and zoom of the camera.
    place : ndarray, (2,)
        Position of the leaf (down, across), in pixels of a frame without zoom.

    Returns
    -------
    part : ndarray, (row, col, …)
        View of the cropped area of `picture`. It is empty if the leaf is outside the frame.
    cover : ndarray, (row, col, band)
        Coverage of the leaf in this area.
    """
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


# ------------------------------------------------------------------------------------------------------ true motion


def motion_between(course: Course, things: list[Sprite], number: int) -> NDArray[np.float32]:
    """Compute each pixel's true motion since the previous frame.

    Parameters
    ----------
    course : Course
        Motion of the camera and of the leaves.
    things : list of Sprite
        The leaves from front to back.
    number : int
        Frame number.

    Returns
    -------
    ndarray, (3, row, col)
        Downward motion and rightward motion in pixels, and validity. Motion is valid (1) if the pixel shows the same object
        as in the previous frame and no edge is near. Otherwise, and in the whole first frame, the validity is 0.
    """
    size = course.motion.size
    if number == 0:
        return np.zeros((3, *size), np.float32)
    view, earlier = course.view(number), course.view(number - 1)
    top, was = (_shown(course, things, each) for each in (number, number - 1))
    velocity = np.vstack([course.velocity, np.zeros(2)])  # index -1, the last row, is the motionless scene
    source = before(view, earlier, size, velocity[top].transpose(2, 0, 1))
    pixel = np.indices(size)
    nearest = np.rint(source).astype(int)
    inside = np.logical_and.reduce(
        [(at > -ROUNDING_PIXELS) & (at < length - 1 + ROUNDING_PIXELS) for at, length in zip(source, size, strict=True)]
    )
    nearest = np.stack([np.clip(at, 0, length - 1) for at, length in zip(nearest, size, strict=True)])
    seen = inside & (was[nearest[0], nearest[1]] == top) & _sure(top) & _sure(was)[nearest[0], nearest[1]]
    return np.concatenate([pixel - source, seen[None]]).astype(np.float32)


def _shown(course: Course, things: list[Sprite], number: int) -> NDArray[np.intp]:
    """Return the index of the leaf that is visible at each pixel of a frame, or −1 for the scene behind the leaves."""
    view, shown = course.view(number), np.full(course.motion.size, -1)
    for leaf, place in reversed(list(enumerate(course.leaves(number)))):
        part, cover = _part(shown, things[leaf].cover[..., :1], things[leaf].step, view, place)
        part[cover[..., 0] > COVERED] = leaf
    return shown


def _sure(shown: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return a mask of the pixels that are more than EDGE_MARGIN pixels from the edge of an object."""
    side = 2 * EDGE_MARGIN + 1
    return np.asarray(maximum_filter(shown, side) == minimum_filter(shown, side))


# ------------------------------------------------------------------------------------------------- clips of a run

# Last element of the seeds for motion, for shapes and for colours, so that all three are independent.
MOVING, LEAVES, COLOURS = 1, 2, 3


def clip_of(
    scene: Scene | ChannelPicture, wanted: sources.WantedScene, run: SimulationRun
) -> Callable[[int], Scene | ChannelPicture]:
    """Return a function that renders a clip of the scene frame by frame.

    Parameters
    ----------
    scene : Scene or ChannelPicture
        The scene before cropping and rotation.
    wanted : WantedScene
        The recipe entry of the scene.
    run : SimulationRun
        The simulation.

    Returns
    -------
    callable
        Function from a frame number to the part of the scene in this frame.

    Raises
    ------
    ValueError
        If the scene is too small for the camera's motion, or if the cropped scene contains pixels without data.
    """
    framing = wanted.source
    samples = scene.signal if isinstance(scene, ChannelPicture) else scene.reflectance
    framed_size((samples.shape[0], samples.shape[1]), framing, run.camera)
    if isinstance(scene, Scene) and scene.ignored is not None:
        if turned(scene.ignored[..., None].astype(np.float32), framing).any():
            raise ValueError(
                "the scene contains pixels without data, which are not supported in clips; exclude these pixels with crop"
            )
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
    """Return a function that computes the true motion in each frame of a clip.

    Parameters
    ----------
    wanted : WantedScene
        The recipe entry of the scene.
    run : SimulationRun
        The simulation.

    Returns
    -------
    callable
        Function from a frame number to the frame's true motion, as in `motion_between`.
    """
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
    """Draw random reflectances, (leaf, band), or random signals if the scene is a picture of channel signals."""
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
