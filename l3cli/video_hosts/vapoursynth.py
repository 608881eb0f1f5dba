"""VapourSynth filter that renders clips of raw frames to RGB.

    from l3cli.video_hosts.vapoursynth import render

    picture = render(core.bs.VideoSource("raw.mkv"), "table.h5", bits=16)

docs/video.md#vapoursynth describes the parameters.
"""

import os
from typing import Any

import numpy as np

from l3cli.api.frames import Mosaics, pair
from l3cli.errors import L3Error
from l3cli.frames.frame import RawFrame
from l3cli.video_hosts import format_error

INSTALL = 'VapourSynth is missing; install it for Python ≥ 3.12 with: pip install "l3cli[vapoursynth]"'

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
    """Render a clip of mosaics with a table.

    Automatic exposure and an estimated white are computed from the first frame for the whole clip, so that VapourSynth can
    request frames in any order and from any thread. Only one frame is rendered at a time. The first frame is rendered
    immediately, so that errors occur before the clip is played.

    Parameters
    ----------
    clip : vapoursynth.VideoNode
        Mosaics in DN, in a format from GRAY8 to GRAY16.
    table : str or path
        File from `l3 train`.
    bits : {8, 16, 32}, default 8
        Bits per value. With 8 (RGB24) or 16 (RGB48), the frames are sRGB, as in files from `l3 render`. With 32 (RGBS), they
        are linear and not clipped.
    exposure : float, optional
        Factor by which Y is multiplied. [default: automatic exposure]
    white : str, optional
        Scene white, as in `l3 render`. [default: the table's white]
    black_level, white_level : float, optional
        Levels in DN. [default: the table's levels]
    phase : (int, int) or str, optional
        CFA row and column of the first pixel, as (1, 0) or "1,0". [default: (0, 0)]
    size : (int, int) or str, optional
        Expected rows and columns of the frames, as (240, 360) or "240x360". [default: the size of the clip]
    camera : str or path, optional
        Camera model for correcting defective pixels and shading.
    backend, device : str, optional
        Renderer and OpenCL device, as in `l3 render`.
    temporal : bool, default False
        Whether to reduce noise over time, as with `l3 render --temporal`. The result does not depend on the order of
        requests. For a frame out of order, up to 255 earlier frames are filtered first.

    Returns
    -------
    vapoursynth.VideoNode
        The rendered clip.

    Raises
    ------
    vapoursynth.Error
        If the clip, a file or a parameter is invalid. The message has one line.
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
    """Raise L3Error unless a clip has a constant size and a constant integer format from GRAY8 to GRAY16."""
    form = clip.format
    if form is None or not clip.width:
        raise L3Error("the clip's format or size varies; use a clip with a constant format and size")
    if form.color_family != vs.GRAY or form.sample_type != vs.INTEGER or form.bits_per_sample > 16:
        raise L3Error(f"the clip has the format {form.name}; use a mosaic in DN with a format from GRAY8 to GRAY16")


def _colours(linear: bool) -> dict[str, int]:
    """Return the frame properties for full-range sRGB, or for linear RGB with sRGB primaries."""
    transfer = vs.TRANSFER_LINEAR if linear else vs.TRANSFER_IEC_61966_2_1
    named = {"_Matrix": vs.MATRIX_RGB, "_Primaries": vs.PRIMARIES_BT709, "_Transfer": transfer, "_Range": vs.RANGE_FULL}
    return {name: int(value) for name, value in named.items()}
