"""What a camera model corrects in its raw frames: defective pixels are mended, shading goes with the frame."""

import hashlib
from dataclasses import dataclass, replace

import numpy as np

from l3cli.artifacts.camera import CameraModel
from l3cli.errors import InputFileError
from l3cli.frame import RawFrame
from l3cli.mending import Mending, plan_mending
from l3cli.shading import Shading, shading_of


@dataclass(frozen=True, eq=False)
class Correction:
    """The correction of one camera's frames."""

    camera: str  # its name
    shape: tuple[int, int]  # rows, columns of its frames
    mending: Mending | None
    shading: Shading | None

    @property
    def digest(self) -> str:
        """SHA-256 of all that it changes in a picture."""
        parts = (self.mending.target, self.mending.source) if self.mending else ()
        gains = (self.shading.gain, self.shading.tint) if self.shading else ()
        content = [each.tobytes() for each in (*parts, *gains) if each is not None]
        return hashlib.sha256(repr(self.shape).encode() + b"".join(content)).hexdigest()

    def corrected(self, frame: RawFrame) -> RawFrame:
        """The frame with its defects mended and the shading that is in it, which takes the place of the file's own gains.

        InputFileError if it is not of the camera's size, or begins at another site of its array.
        """
        if frame.values.shape != self.shape or frame.phase != (0, 0):
            raise InputFileError(
                f"{frame.name} of {_size(frame.values.shape)} pixels, first site {frame.phase[0]},{frame.phase[1]}, is no "
                f"whole frame of camera {self.camera} of {_size(self.shape)}; give the ‹camera› that took it"
            )
        values = frame.values if self.mending is None else self.mending.mended(frame.values)
        return replace(frame, values=values, shading=self.shading or frame.shading)


def correction_of(camera: CameraModel) -> Correction:
    """The correction of a camera's frames; InputFileError if it knows of none, or cannot be carried out."""
    if camera.defects is None and camera.flat_field is None:
        raise InputFileError(
            f"camera {camera.name} knows neither defects nor a flat field; calibrate it with darks and whites"
        )
    shape, mending = (camera.rows, camera.cols), None
    if camera.defects is not None and camera.defects.position.size:
        bad = np.zeros(shape, bool)
        bad[tuple(camera.defects.position.T)] = True
        mending = plan_mending(bad, camera.cfa)
    shading = None if camera.flat_field is None else shading_of(camera.flat_field, shape, camera.cfa)
    return Correction(camera.name, shape, mending, shading)


def _size(shape: tuple[int, ...]) -> str:
    return "×".join(map(str, shape))
