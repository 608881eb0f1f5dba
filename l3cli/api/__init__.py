"""The Python interface as `l3cli.NAME`: the four stages, evaluation, artifacts, raw frames, a renderer, figures of pictures.

    import l3cli as l3

    camera = l3.calibrate("lab/MEASUREMENTS.toml", "camera.h5")
    l3.simulate("default", camera, "training.h5", jobs=2)
    table = l3.train("training.h5", "table.h5", jobs=2)
    picture = l3.Renderer(table).picture(l3.read_raw("frame.dng", table))

Stages take paths or artifacts, write the file that the command of their name writes, byte for byte, and return its content.
They raise the errors of `l3cli.errors`: RecipeError (a wrong call or recipe), InputFileError, DeviceError, L3Error. They say
nothing unless they are given a `console` (`l3cli.system.console.Console`).
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
