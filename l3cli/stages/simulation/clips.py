"""Clips of a simulation: the frames of a scene that has a motion, and what is known of how they move."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from l3cli.simulation import sources
from l3cli.stages.simulation.run import SimulationRun

if TYPE_CHECKING:
    from l3cli.frames.scene import ChannelPicture, Scene
    from l3cli.simulation.motion import Course

MOVING, LEAVES, COLOURS = 1, 2, 3  # parts of a seed: course, shapes, and colours of the leaves


def clip_of(
    scene: "Scene | ChannelPicture", wanted: sources.WantedScene, run: SimulationRun
) -> "Callable[[int], Scene | ChannelPicture]":
    """The scene, as it was drawn or read, in each frame of its clip; ValueError if the camera moves beyond it."""
    from dataclasses import replace

    from l3cli.frames.scene import ChannelPicture
    from l3cli.simulation import clip
    from l3cli.simulation.framing import framed_size, scale_of, turned

    framing = wanted.source
    samples = scene.signal if isinstance(scene, ChannelPicture) else scene.reflectance
    framed_size((samples.shape[0], samples.shape[1]), framing, run.camera)
    canvas = np.ascontiguousarray(turned(samples, framing))
    scale = scale_of(framing, run.camera, canvas.shape[1]) or 1.0
    course = _course(wanted, run)
    things = clip.sprites(course, _colours(scene, len(course.radius), wanted, run), _seed(wanted, run, LEAVES))

    def frame(number: int) -> "Scene | ChannelPicture":
        seen = clip.frame(canvas, scale, course, things, number)
        return replace(scene, signal=seen) if isinstance(scene, ChannelPicture) else replace(scene, reflectance=seen)

    return frame


def known_motion(wanted: sources.WantedScene, run: SimulationRun) -> Callable[[int], NDArray[np.float32]]:
    """Return a function that gives the motion of each frame of a clip since the frame before, as `clip.motion_between`
    does."""
    from l3cli.simulation import clip

    course = _course(wanted, run)
    things = clip.sprites(course, np.zeros((len(course.radius), 1)), _seed(wanted, run, LEAVES))
    return lambda number: clip.motion_between(course, things, number)


def _course(wanted: sources.WantedScene, run: SimulationRun) -> "Course":
    from l3cli.simulation.motion import course

    motion = wanted.source.motion
    assert motion is not None
    return course(motion, _seed(wanted, run, MOVING))


def _colours(
    scene: "Scene | ChannelPicture", count: int, wanted: sources.WantedScene, run: SimulationRun
) -> NDArray[np.float32]:
    """Reflectances or signals (leaf, band) of the leaves."""
    from l3cli.frames.scene import ChannelPicture
    from l3cli.simulation.reflectances import DRAWN, palette, surfaces

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
