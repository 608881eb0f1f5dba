"""Python interface of l3.

Import the package as `l3cli`. It provides the stages of the pipeline, functions that load and save artifacts and raw
frames, a renderer, and metrics.

    import l3cli as l3

    camera = l3.calibrate("lab/MEASUREMENTS.toml", "camera.h5")
    l3.simulate("default", camera, "training.h5", jobs=2)
    table = l3.train("training.h5", "table.h5", jobs=2)
    picture = l3.Renderer(table).picture(l3.read_raw("frame.dng", table))

The functions `calibrate`, `simulate`, `train`, `render` and `evaluate` do the same work as the commands of the same names,
and write identical files. Their arguments are paths or artifacts. `calibrate`, `simulate` and `train` return the artifact
that they have written. `render` returns the number of skipped frames. `evaluate` returns a dictionary of metrics.

These functions print nothing. Warnings become Python warnings (UserWarning). If you pass a `console`
(`l3cli.system.console.Console`), it receives all messages instead.

l3 raises `L3Error` or one of its subclasses in `l3cli.errors`: RecipeError for an invalid argument or recipe, InputFileError
for an unusable file, and DeviceError for an OpenCL failure. Error messages quote parameter names as in ‹force›.
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
