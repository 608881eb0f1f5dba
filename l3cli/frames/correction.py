"""Corrections of raw frames by a camera model: defective pixels are replaced, shading goes with the frame."""

import hashlib
from dataclasses import dataclass, replace

import numpy as np

from l3cli.artifacts.camera import CameraModel
from l3cli.errors import InputFileError
from l3cli.frames.bad_pixels import BadPixelCorrection, plan_correction
from l3cli.frames.frame import RawFrame
from l3cli.frames.shading import Shading, shading_of


@dataclass(frozen=True, eq=False)
class Correction:
    """The correction of one camera's frames."""

    camera: str  # its name
    shape: tuple[int, int]  # rows, columns of its frames
    bad_pixels: BadPixelCorrection | None
    shading: Shading | None

    @property
    def digest(self) -> str:
        """SHA-256 of all that it changes in a picture."""
        parts = (self.bad_pixels.target, self.bad_pixels.source) if self.bad_pixels else ()
        gains = (self.shading.gain, self.shading.tint) if self.shading else ()
        content = [each.tobytes() for each in (*parts, *gains) if each is not None]
        return hashlib.sha256(repr(self.shape).encode() + b"".join(content)).hexdigest()

    def corrected(self, frame: RawFrame) -> RawFrame:
        """Return the frame with its bad pixels corrected and the shading that is in it, which takes the place of the file's
        own gains.

        InputFileError if it is not of the camera's size, or begins at another site of its array.
        """
        if frame.values.shape != self.shape or frame.phase != (0, 0):
            raise InputFileError(
                f"{frame.name} of {_size(frame.values.shape)} pixels, first site {frame.phase[0]},{frame.phase[1]}, is no "
                f"whole frame of camera {self.camera} of {_size(self.shape)}; give the ‹camera› that took it"
            )
        values = frame.values if self.bad_pixels is None else self.bad_pixels.corrected(frame.values)
        return replace(frame, values=values, shading=self.shading or frame.shading)


def correction_of(camera: CameraModel) -> Correction:
    """Return the correction of a camera's frames; InputFileError if it knows of none, or cannot be carried out."""
    if camera.defects is None and camera.flat_field is None:
        raise InputFileError(
            f"camera {camera.name} knows neither defects nor a flat field; calibrate it with darks and whites"
        )
    shape, bad_pixels = (camera.rows, camera.cols), None
    if camera.defects is not None and camera.defects.position.size:
        bad = np.zeros(shape, bool)
        bad[tuple(camera.defects.position.T)] = True
        bad_pixels = plan_correction(bad, camera.cfa)
    shading = None if camera.flat_field is None else shading_of(camera.flat_field, shape, camera.cfa)
    return Correction(camera.name, shape, bad_pixels, shading)


def _size(shape: tuple[int, ...]) -> str:
    return "×".join(map(str, shape))
