"""[scene.motion] of a scene recipe: a clip in which the camera and objects move over a scene (docs/method.md#motion).

Places are in pixels of an unzoomed frame, down and right, measured from the middle of the scene. Time is counted in frames.
In the middle of the clip the camera looks at the middle of the scene.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import msgspec
import numpy as np
from numpy.typing import NDArray

from l3cli.recipes.faults import Fault, fault
from l3cli.recipes.toml import Count, NotNegative, Recipe, Share

Array = NDArray[np.float64]
Zoom = Annotated[float, msgspec.Meta(ge=0.5, le=2.0)]
Radius = Annotated[float, msgspec.Meta(gt=0, le=256)]
FARTHEST_SHAKE = 3.0  # standard deviations; larger displacements are clipped
LEAST_ZOOM = 1e-6  # avoids a division by zero in very long clips that zoom
SUBFRAMES = 8  # moments averaged over the time that the shutter is open


class MovingLeaves(Recipe):
    """Leaves, each of a single material, that cross the scene in straight lines. The first leaf is the topmost."""

    count: Annotated[int, msgspec.Meta(ge=1, le=64)] = 1
    radius_pixels: tuple[Radius, Radius] = (8.0, 24.0)  # smallest, largest
    speed_pixels_per_frame: tuple[NotNegative, NotNegative] = (1.0, 2.0)  # slowest, fastest; each leaf has its own direction


class Motion(Recipe):
    """A clip instead of a single frame.

    The frames show a part of the scene, and the camera moves within the rest.
    """

    frames: Count
    size: tuple[Count, Count]  # rows, cols of each frame in pixels
    # motion of the camera, down and right; the content of the frames moves up and left
    pan_pixels_per_frame: tuple[float, float] = (0.0, 0.0)
    zoom_per_frame: Zoom = 1.0  # magnification relative to the previous frame, about the middle
    shake_pixels: NotNegative = 0.0  # standard deviation of a frame's displacement, down and right, clipped at three
    shutter: Share = 0.0  # fraction of the frame interval during which light is collected, which causes motion blur
    leaves: MovingLeaves | None = None


@dataclass(frozen=True)
class View:
    """Where the camera looks at one moment, and its zoom."""

    centre: tuple[float, float]  # place that the middle of the frame shows
    zoom: float  # pixels of the frame per pixel of an unzoomed one


@dataclass(frozen=True)
class Course:
    """Motion of the camera and of the leaves in one clip.

    `course` draws it: equal seeds give equal motion.
    """

    motion: Motion
    shake: Array  # (frame, 2) pixels
    start: Array  # (leaf, 2) place in the middle of the clip
    velocity: Array  # (leaf, 2) pixels per frame
    radius: Array  # (leaf) pixels

    def view(self, frame: int, moment: float = 0.0) -> View:
        """Return the view at `moment` frames after the middle of a frame's exposure."""
        since = self._since_middle(frame) + moment
        pan, shake = self.motion.pan_pixels_per_frame, self.shake[frame]
        centre = tuple(speed * since + float(aside) for speed, aside in zip(pan, shake, strict=True))
        return View((centre[0], centre[1]), self.motion.zoom_per_frame**since)

    def leaves(self, frame: int, moment: float = 0.0) -> Array:
        """Return the places (leaf, 2) of the leaves at `moment` frames after the middle of a frame's exposure."""
        return self.start + self.velocity * (self._since_middle(frame) + moment)

    def moments(self) -> list[float]:
        """Return the times, in frames after the middle of the exposure, whose mean makes up a frame."""
        if self.motion.shutter == 0:
            return [0.0]
        return [self.motion.shutter * ((step + 0.5) / SUBFRAMES - 0.5) for step in range(SUBFRAMES)]

    def _since_middle(self, frame: int) -> float:
        return frame - (self.motion.frames - 1) / 2


def course(motion: Motion, seed: tuple[int, ...]) -> Course:
    """Draw the motion of a clip.

    Shake and leaves have separate random generators, so changing one does not change the other.
    """
    shaking, flying = np.random.default_rng(seed).spawn(2)
    shake = np.clip(shaking.standard_normal((motion.frames, 2)), -FARTHEST_SHAKE, FARTHEST_SHAKE) * motion.shake_pixels
    leaves = motion.leaves
    if leaves is None:
        return Course(motion, shake, np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
    start = (flying.random((leaves.count, 2)) - 0.5) * motion.size
    angle, speed = flying.uniform(0, 2 * np.pi, leaves.count), flying.uniform(*leaves.speed_pixels_per_frame, leaves.count)
    velocity = speed[:, None] * np.stack([np.sin(angle), np.cos(angle)], axis=1)
    return Course(motion, shake, start, velocity, flying.uniform(*leaves.radius_pixels, leaves.count))


def room(motion: Motion) -> tuple[float, float]:
    """Return the rows and columns of the scene that a clip may see, whatever its seed, in pixels of an unzoomed frame."""
    last = (motion.frames - 1) / 2 + motion.shutter / 2
    widest = max(min(motion.zoom_per_frame, 1 / motion.zoom_per_frame) ** last, LEAST_ZOOM)
    shake, pan = FARTHEST_SHAKE * motion.shake_pixels, motion.pan_pixels_per_frame
    rows, cols = (length / widest + 2 * (abs(by) * last + shake) for length, by in zip(motion.size, pan, strict=True))
    return rows, cols


def before(view: View, earlier: View, size: tuple[int, int], moved: Array | float = 0.0) -> Array:
    """Return where the previous frame showed the content of each pixel.

    Parameters
    ----------
    view, earlier : View
        View of this frame and of the previous one.
    size : tuple of int
        Rows and columns of a frame.
    moved : float or ndarray, (2, row, col)
        Motion of the content itself since then, in pixels of an unzoomed frame.

    Returns
    -------
    ndarray, (2, row, col)
        Row and column in the earlier frame, in its pixels.
    """
    middle = (np.array(size) - 1) / 2
    pixel = np.stack(np.meshgrid(np.arange(size[0]), np.arange(size[1]), indexing="ij")) - middle[:, None, None]
    place = pixel / view.zoom + np.array(view.centre)[:, None, None] - moved
    return (place - np.array(earlier.centre)[:, None, None]) * earlier.zoom + middle[:, None, None]


def motion_faults(motion: Motion, name: str) -> Iterator[Fault]:
    """Yield the faults of the clip of the scene called `name`."""
    leaves = motion.leaves
    for key in ("radius_pixels", "speed_pixels_per_frame") if leaves is not None else ():
        low, high = getattr(leaves, key)
        if low > high:
            yield fault(f"{name}: {key} runs from {low:g} to {high:g}; give the smaller value first", f"motion.leaves.{key}")
