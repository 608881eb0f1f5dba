"""The table [scene.motion] of a scene recipe: a clip with a moving camera and moving leaves (docs/method.md#motion).

Positions (down, right) are measured from the scene's centre, in pixels of a frame without zoom. The unit of time is the
frame interval. In the middle of the clip, the frame is centred on the scene.
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
FARTHEST_SHAKE = 3.0  # limit of random displacements, in standard deviations
LEAST_ZOOM = 1e-6  # avoids a division by zero in very long clips that zoom out
SUBFRAMES = 8  # motion blur is simulated by averaging the frame over this number of instants during the exposure


class MovingLeaves(Recipe):
    """Leaves of one material each that move across the scene in straight lines. The first leaf is in front."""

    count: Annotated[int, msgspec.Meta(ge=1, le=64)] = 1
    radius_pixels: tuple[Radius, Radius] = (8.0, 24.0)  # smallest and largest radius
    speed_pixels_per_frame: tuple[NotNegative, NotNegative] = (1.0, 2.0)  # lowest and highest speed; directions are random


class Motion(Recipe):
    """Settings of a simulated clip, in which the camera moves over a scene and each frame shows a part of it."""

    frames: Count
    size: tuple[Count, Count]  # rows and columns of each frame, in pixels
    # motion of the camera (down, right); the content of the picture moves in the opposite direction
    pan_pixels_per_frame: tuple[float, float] = (0.0, 0.0)
    zoom_per_frame: Zoom = 1.0  # magnification about the centre, relative to the previous frame
    shake_pixels: NotNegative = 0.0  # standard deviation of each frame's random displacement, which is clipped to 3 σ
    shutter: Share = 0.0  # exposure time as a fraction of the frame interval, which determines the motion blur
    leaves: MovingLeaves | None = None


@dataclass(frozen=True)
class View:
    """Position and zoom of the camera at one instant."""

    centre: tuple[float, float]  # position in the scene at the centre of the frame
    zoom: float  # magnification relative to a frame without zoom


@dataclass(frozen=True)
class Course:
    """Motion of the camera and the leaves in one clip, drawn at random by the function `course`."""

    motion: Motion
    shake: Array  # (frame, 2), random displacement in pixels
    start: Array  # (leaf, 2), position in the middle of the clip
    velocity: Array  # (leaf, 2), pixels per frame
    radius: Array  # (leaf,), pixels

    def view(self, frame: int, moment: float = 0.0) -> View:
        """Return the view in frame number `frame`, `moment` frame intervals after mid-exposure."""
        since = self._since_middle(frame) + moment
        pan, shake = self.motion.pan_pixels_per_frame, self.shake[frame]
        centre = tuple(speed * since + float(aside) for speed, aside in zip(pan, shake, strict=True))
        return View((centre[0], centre[1]), self.motion.zoom_per_frame**since)

    def leaves(self, frame: int, moment: float = 0.0) -> Array:
        """Return the position of each leaf in frame number `frame`, `moment` frame intervals after mid-exposure."""
        return self.start + self.velocity * (self._since_middle(frame) + moment)

    def moments(self) -> list[float]:
        """Return the instants over which a frame is averaged for motion blur, in frame intervals from mid-exposure."""
        if self.motion.shutter == 0:
            return [0.0]
        return [self.motion.shutter * ((step + 0.5) / SUBFRAMES - 0.5) for step in range(SUBFRAMES)]

    def _since_middle(self, frame: int) -> float:
        return frame - (self.motion.frames - 1) / 2


def course(motion: Motion, seed: tuple[int, ...]) -> Course:
    """Draw the motion of a clip at random.

    Shake and leaves have separate random generators, so that a change in the shake does not affect the leaves.
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
    """Return the largest scene area (rows, columns) that a clip can need with any seed, in pixels without zoom."""
    last = (motion.frames - 1) / 2 + motion.shutter / 2
    widest = max(min(motion.zoom_per_frame, 1 / motion.zoom_per_frame) ** last, LEAST_ZOOM)
    shake, pan = FARTHEST_SHAKE * motion.shake_pixels, motion.pan_pixels_per_frame
    rows, cols = (length / widest + 2 * (abs(by) * last + shake) for length, by in zip(motion.size, pan, strict=True))
    return rows, cols


def before(view: View, earlier: View, size: tuple[int, int], moved: Array | float = 0.0) -> Array:
    """Find the position in the previous frame of the scene point at each pixel of a frame.

    Parameters
    ----------
    view, earlier : View
        View of this frame and of the previous frame.
    size : tuple of int
        Rows and columns of a frame.
    moved : float or ndarray, (2, row, col)
        Motion of the object between the two frames, in pixels of a frame without zoom.

    Returns
    -------
    ndarray, (2, row, col)
        Row and column in the previous frame, in pixels of that frame.
    """
    middle = (np.array(size) - 1) / 2
    pixel = np.stack(np.meshgrid(np.arange(size[0]), np.arange(size[1]), indexing="ij")) - middle[:, None, None]
    place = pixel / view.zoom + np.array(view.centre)[:, None, None] - moved
    return (place - np.array(earlier.centre)[:, None, None]) * earlier.zoom + middle[:, None, None]


def motion_faults(motion: Motion, name: str) -> Iterator[Fault]:
    """Find the faults in a scene's motion settings. Each message begins with `name`, the name of the scene."""
    leaves = motion.leaves
    for key in ("radius_pixels", "speed_pixels_per_frame") if leaves is not None else ():
        low, high = getattr(leaves, key)
        if low > high:
            message = f"{name}: {key} is {[low, high]}; write the smaller value first"
            yield fault(message, f"motion.leaves.{key}")
