"""Build an image-processing pipeline for a camera with any colour filter array: calibrate, simulate, train, render.

The names in `__all__` are imported from `l3cli.api` when they are first used.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from l3cli.api import *  # noqa: F403

__version__ = "0.1.0"
__all__ = [
    "L3Error", "Renderer", "calibrate", "delta_e_2000", "evaluate", "load", "load_camera", "load_table",
    "load_training_set", "psnr", "raw_frame", "read_raw", "region", "render", "save", "scielab", "simulate", "ssim", "train",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from l3cli import api

    return getattr(api, name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
