"""Create dark frames that contain the glare measured in chart photos (docs/method.md#charts-in-photographs)."""

import io
from pathlib import Path

import numpy as np
import tifffile

from l3cli.artifacts.camera import CameraModel
from l3cli.physics.mosaic import shifted_cfa, tiled

LARGEST_DN = 65535  # largest 16-bit value
# `l3 render` estimates the noise of dark frames from differences between pages. Two identical pages count as noise-free.
PAGES = 2


def glare_files(camera: CameraModel) -> dict[str, bytes]:
    """Create one dark frame for each chart photo that was used in the calibration.

    A dark frame contains the black level plus each channel's glare. `l3 render --dark` can subtract it from the chart photo,
    or from another photo taken in the same place.

    Parameters
    ----------
    camera : CameraModel
        The camera model.

    Returns
    -------
    dict of str to bytes
        File name → content of the TIFF file. Empty if the camera was not calibrated from chart photos.
    """
    photo = camera.fit.photo if camera.fit else None
    if photo is None:
        return {}
    files = {}
    for number, (name, glare) in enumerate(zip(photo.names, photo.glare, strict=True)):
        suffix = f"_{number + 1}" if len(photo.names) > 1 else ""
        phase, shape = ((0, 0), (camera.rows, camera.cols)) if photo.window is None else photo.window.of(number)
        values = np.clip(np.rint(camera.black_level + glare), 0, LARGEST_DN).astype(np.uint16)
        content = io.BytesIO()
        with tifffile.TiffWriter(content) as file:
            for _ in range(PAGES):
                file.write(
                    values[tiled(shifted_cfa(camera.cfa, phase), shape)],
                    compression="zlib",
                    photometric="minisblack",
                    metadata=None,
                    software=None,
                )
        files[f"{Path(name).stem}{suffix}_offsets.tif"] = content.getvalue()
    return files
