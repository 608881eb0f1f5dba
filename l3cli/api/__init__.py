"""Python interface of l3.

Import the package as `l3cli`. It provides the stages of the pipeline, loading and saving of artifacts, raw frames, a
renderer and metrics.

    import l3cli as l3

    camera = l3.calibrate("lab/MEASUREMENTS.toml", "camera.h5")
    l3.simulate("default", camera, "training.h5", jobs=2)
    table = l3.train("training.h5", "table.h5", jobs=2)
    picture = l3.Renderer(table).picture(l3.read_raw("frame.dng", table))

The functions `calibrate`, `simulate`, `train`, `render` and `evaluate` do the same as the commands with these names. Their
arguments are paths or artifacts, and the files that they write are identical to the files of the commands. `calibrate`,
`simulate` and `train` return the artifact that was written. `render` returns the number of frames that could not be read.
`evaluate` returns a dictionary of metrics.

These functions do not print anything. Warnings of the command become Python warnings (UserWarning). If you pass a `console`
(`l3cli.system.console.Console`), the console receives all messages instead.

All errors of l3 are subclasses of `L3Error` in `l3cli.errors`: RecipeError for a wrong argument or recipe, InputFileError
for an unusable file, and DeviceError if OpenCL fails. Messages show the names of parameters in angle quotes, such as
‹force›.
"""

from l3cli.api.figures import delta_e_2000, psnr, scielab, ssim
from l3cli.api.frames import Renderer, raw_frame, read_raw
from l3cli.api.stages import (
    calibrate,
    evaluate,
    load,
    load_camera,
    load_table,
    load_training_set,
    render,
    save,
    simulate,
    train,
)
from l3cli.errors import L3Error
from l3cli.rendering.uncertainty import region

__all__ = [
    "L3Error", "Renderer", "calibrate", "delta_e_2000", "evaluate", "load", "load_camera", "load_table",
    "load_training_set", "psnr", "raw_frame", "read_raw", "region", "render", "save", "scielab", "simulate", "ssim", "train",
]  # fmt: skip
