"""[scene.motion] of SCENES.toml: a clip of a scene, by a camera that moves, of things that move (docs/method.md#motion).

Places are in pixels of an unzoomed frame, down and right, from the middle of the scene. Time is counted in frames; in the
middle of the clip the camera looks at the middle of the scene.
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
FARTHEST_SHAKE = 3.0  # standard deviations
LEAST_ZOOM = 1e-6
SUBFRAMES = 8  # moments that an open shutter averages


class MovingLeaves(Recipe):
    """Leaves of one material each that cross the scene, straight ahead, the first of them on top."""

    count: Annotated[int, msgspec.Meta(ge=1, le=64)] = 1
    radius_pixels: tuple[Radius, Radius] = (8.0, 24.0)  # smallest, largest
    speed_pixels_per_frame: tuple[NotNegative, NotNegative] = (1.0, 2.0)  # slowest, fastest; each in a direction of its own


class Motion(Recipe):
    """A clip in the place of one frame; what of the scene is outside its frames is room for the camera to move in."""

    frames: Count
    size: tuple[Count, Count]  # rows, cols of each frame in pixels
    # of the camera, down and right: what it sees moves up and left
    pan_pixels_per_frame: tuple[float, float] = (0.0, 0.0)
    zoom_per_frame: Zoom = 1.0  # magnification over the frame before, about the middle
    shake_pixels: NotNegative = 0.0  # standard deviation of a frame's displacement, down and right; never more than three
    shutter: Share = 0.0  # share of the time between two frames in which light is collected, which blurs what moves
    leaves: MovingLeaves | None = None


@dataclass(frozen=True)
class View:
    """View of the camera in a moment."""

    centre: tuple[float, float]  # the place in the middle of the frame
    zoom: float  # pixels of the frame in one of an unzoomed one


@dataclass(frozen=True)
class Course:
    """Course of the camera and the leaves of one clip: the same for the same seed."""

    motion: Motion
    shake: Array  # (frame, 2) pixels
    start: Array  # (leaf, 2) place in the middle of the clip
    velocity: Array  # (leaf, 2) pixels a frame
    radius: Array  # (leaf) pixels

    def view(self, frame: int, moment: float = 0.0) -> View:
        """Return the view of a frame, `moment` frames after its middle."""
        since = self._since_middle(frame) + moment
        pan, shake = self.motion.pan_pixels_per_frame, self.shake[frame]
        centre = tuple(speed * since + float(aside) for speed, aside in zip(pan, shake, strict=True))
        return View((centre[0], centre[1]), self.motion.zoom_per_frame**since)

    def leaves(self, frame: int, moment: float = 0.0) -> Array:
        """Return the places (leaf, 2) of the leaves."""
        return self.start + self.velocity * (self._since_middle(frame) + moment)

    def moments(self) -> list[float]:
        """Return the times after a frame's middle at which it collects light, in frames."""
        if self.motion.shutter == 0:
            return [0.0]
        return [self.motion.shutter * ((step + 0.5) / SUBFRAMES - 0.5) for step in range(SUBFRAMES)]

    def _since_middle(self, frame: int) -> float:
        return frame - (self.motion.frames - 1) / 2


def course(motion: Motion, seed: tuple[int, ...]) -> Course:
    """Return the course of a clip. Shake and leaves are drawn apart, so that neither changes the other."""
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
    """Return the rows and columns, in pixels of an unzoomed frame, that a clip of any seed may see."""
    last = (motion.frames - 1) / 2 + motion.shutter / 2
    widest = max(min(motion.zoom_per_frame, 1 / motion.zoom_per_frame) ** last, LEAST_ZOOM)
    shake, pan = FARTHEST_SHAKE * motion.shake_pixels, motion.pan_pixels_per_frame
    rows, cols = (length / widest + 2 * (abs(by) * last + shake) for length, by in zip(motion.size, pan, strict=True))
    return rows, cols


def before(view: View, earlier: View, size: tuple[int, int], moved: Array | float = 0.0) -> Array:
    """Return the places (2, row, col) in the frame of an `earlier` view, in its pixels, of what the pixels of a view
    show, if it has `moved` (2, row, col) pixels of an unzoomed frame since."""
    middle = (np.array(size) - 1) / 2
    pixel = np.stack(np.meshgrid(np.arange(size[0]), np.arange(size[1]), indexing="ij")) - middle[:, None, None]
    place = pixel / view.zoom + np.array(view.centre)[:, None, None] - moved
    return (place - np.array(earlier.centre)[:, None, None]) * earlier.zoom + middle[:, None, None]


def motion_faults(motion: Motion, name: str) -> Iterator[Fault]:
    """Yield all that cannot be of a clip of the scene called `name`."""
    leaves = motion.leaves
    for key in ("radius_pixels", "speed_pixels_per_frame") if leaves is not None else ():
        low, high = getattr(leaves, key)
        if low > high:
            yield fault(f"{name}: {key} is {low:g} to {high:g}; give the smaller first", f"motion.leaves.{key}")
