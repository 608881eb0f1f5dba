"""Python interface of l3, imported as `l3cli`: stages, artifacts, raw frames, a renderer and image-quality metrics.

    import l3cli as l3

    camera = l3.calibrate("lab/MEASUREMENTS.toml", "camera.h5")
    l3.simulate("default", camera, "training.h5", jobs=2)
    table = l3.train("training.h5", "table.h5", jobs=2)
    picture = l3.Renderer(table).picture(l3.read_raw("frame.dng", table))

A stage takes paths or artifacts, writes the same bytes as the command of its name, and returns what it wrote. Stages print
nothing. What the command warns about is a Python warning (UserWarning), unless you pass a `console`
(`l3cli.system.console.Console`), which then receives all messages.

All errors are subclasses of `L3Error`, in `l3cli.errors`: RecipeError for a wrong argument or recipe, InputFileError for an
unusable file, DeviceError for OpenCL. Messages name a parameter as ‹force›.
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
