"""The file that `l3 render --uncertainty` writes."""

from pathlib import Path

import numpy as np

from l3cli.errors import InputFileError
from l3cli.io.pictures.registry import write_picture
from l3cli.physics.stokes import FEATURES
from l3cli.rendering.renderer import NoiseRenderer
from l3cli.stages.rendering.job import Job
from l3cli.stages.rendering.look import Look


def write_uncertainty(job: Job, look: Look) -> Path:
    """Write an EXR file with the standard deviation of each output and a mask (docs/measurement.md#uncertainty).

    The job must have a single frame. The fraction of masked pixels is printed on the console.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputFileError
        If the frame is missing.
    """
    from l3cli.rendering.uncertainty import uncertainty  # imported here to save start-up time, because few runs need it

    path, table = job.options.uncertainty, look.table
    assert path is not None
    (frame,) = (look.sequence.frames.read(number) for number in look.sequence.frames.wanted)
    if frame is None:
        raise InputFileError("‹uncertainty› needs a frame, but the input contains no frames; use an input with one frame")
    result = uncertainty(NoiseRenderer(job.options.backend, table, **job.engine).of_frame(frame), frame)
    planes, names = [result.sigma], table.outputs
    if result.polarisation is not None:
        planes, names = [*planes, result.polarisation], names + FEATURES
    pixels = np.concatenate([*planes, result.mask[..., None].astype(np.float32)], axis=2)
    write_picture(path, pixels, (*(f"sigma.{name}" for name in names), "mask"))
    fraction = float((result.mask > 0).mean())
    job.options.console.info(
        f"wrote {path}; {fraction:.1%} of the pixels are in the mask, because they are clipped or their classes have no "
        "training patches"
    )
    return path
