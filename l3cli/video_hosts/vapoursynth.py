"""A VapourSynth filter: clips of raw frames to RGB.

from l3cli.video_hosts.vapoursynth import render

picture = render(core.bs.VideoSource("raw.mkv"), "table.h5", bits=16)
"""

import os
from typing import Any

import numpy as np

from l3cli.api.frames import Mosaics, pair
from l3cli.errors import L3Error
from l3cli.frames.frame import RawFrame
from l3cli.video_hosts import format_error

INSTALL = 'VapourSynth is missing; install it, with Python ≥ 3.12, by: pip install "l3cli[vapoursynth]"'

try:
    import vapoursynth as vs
except ModuleNotFoundError as missing:
    raise L3Error(INSTALL) from missing

FORMATS = {8: vs.RGB24, 16: vs.RGB48, 32: vs.RGBS}


def render(
    clip: Any, table: str | os.PathLike[str], *, bits: int = 8, exposure: float | None = None, white: str | None = None,
    black_level: float | None = None, white_level: float | None = None, phase: tuple[int, int] | str | None = None,
    size: tuple[int, int] | str | None = None, camera: str | os.PathLike[str] | None = None, backend: str = "opencl",
    device: str | None = None, temporal: bool = False,
) -> Any:  # fmt: skip
    """Return the clip (vapoursynth.VideoNode) that a table makes of a clip of mosaics, GRAY8 to GRAY16, values in DN.

    `bits`: 8 gives RGB24 and 16 RGB48, sRGB as `l3 render` writes it; 32 RGBS, linear and not clipped. `exposure`: factor of
    Y, `white`: of the scene, as in `l3 render`; what is measured, as without them, is measured on the first frame and holds
    for the clip, so that frames may be asked for in any order. `black_level`, `white_level` (DN), `phase` (CFA row, column
    of the first pixel, also as "1,0"): None: the table's. `size` (rows, columns, also as "240x360"): that frames
    must have, None: any. `camera`: of a model whose defects and flat field are corrected. `backend`, `device`: as there.
    `temporal`: frames are filtered in time, as in `l3 render --temporal`, each the same in any order of requests: one that
    does not follow the last is filtered after the up to 255 before it that it depends on.

    Frames may be rendered from any number of threads; one is at work on the device at a time. The first is rendered at once.
    vapoursynth.Error, one line, for a clip, file or value that does not fit.
    """
    try:
        _require_mosaics(clip)
        phase = pair(phase, ",", "phase") if isinstance(phase, str) else phase
        size = pair(size, "x", "size") if isinstance(size, str) else size
        mosaics = Mosaics(
            table, black_level=black_level, white_level=white_level, phase=phase, size=size or (clip.height, clip.width),
            camera=camera, backend=backend, device=device,
        )  # fmt: skip
        mosaics.require_size(clip.height, clip.width)
        show = mosaics.renderer.sequence(None, exposure=exposure, white=white, bits=bits)

        def read(number: int) -> RawFrame:
            with clip.get_frame(number) as raw:
                return mosaics.frame(np.array(raw[0]))

        show(read(0))
        in_time = mosaics.in_time(read, cache=2 * vs.core.num_threads) if temporal else None
    except (L3Error, OSError) as error:
        raise vs.Error(f"l3: {format_error(error)}") from error

    def shown(n: int, f: list[Any]) -> Any:
        raw, made = f[0], f[1].copy()
        try:
            frame = mosaics.frame(np.asarray(raw[0]))
            picture = show(in_time.filtered(n, frame) if in_time else frame)
        except L3Error as error:
            raise vs.Error(f"l3: frame {n}: {format_error(error)}") from error
        for plane in range(3):
            np.asarray(made[plane])[...] = picture[..., plane]
        made.props.update(raw.props)
        made.props.update(_colours(linear=bits == 32))
        return made

    blank = vs.core.std.BlankClip(clip, format=FORMATS[bits], keep=True)
    return blank.std.ModifyFrame([clip, blank], shown)


def _require_mosaics(clip: Any) -> None:
    """Raise L3Error unless a clip has one plane of 8 to 16 bits, and frames of one format."""
    form = clip.format
    if form is None or not clip.width:
        raise L3Error("the clip's frames differ in format or size; give one of mosaics of one size")
    if form.color_family != vs.GRAY or form.sample_type != vs.INTEGER or form.bits_per_sample > 16:
        raise L3Error(f"the clip is {form.name}; a mosaic is GRAY8 to GRAY16, in DN")


def _colours(linear: bool) -> dict[str, int]:
    """Return the frame properties of the values: sRGB, or linear with its primaries, in full range."""
    transfer = vs.TRANSFER_LINEAR if linear else vs.TRANSFER_IEC_61966_2_1
    named = {"_Matrix": vs.MATRIX_RGB, "_Primaries": vs.PRIMARIES_BT709, "_Transfer": transfer, "_Range": vs.RANGE_FULL}
    return {name: int(value) for name, value in named.items()}
