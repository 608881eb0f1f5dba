"""Options of l3 render."""

import re
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

from l3cli.errors import RecipeError, shortened, suggestion
from l3cli.frames.packings import PACKINGS, packing_named
from l3cli.options.option import (
    LEVEL,
    PAIR,
    SITE,
    BackendOptions,
    DeviceOptions,
    ForceOptions,
    Given,
    Name,
    Number,
    OnePath,
    Output,
    Pair,
    Reader,
    SchedulerOptions,
    Shard,
    option,
    options,
)

Preset = Literal["ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow"]
GAIN = Number(1 / 1024, 1024, "times")


class Exposure(NamedTuple):
    """Exposure of pictures."""

    factor: float | None  # of Y; None: automatic
    stops: float = 0.0  # EV by which pictures are brighter than automatic
    stated: bool = False  # whether the factor is times that of each file (BaselineExposure)


class ExposureReader(Reader):
    """A factor of Y, "auto", stops from the automatic exposure ("+1EV"), or "camera", what each file states."""

    factor, stops = Number(1e-9, 1e9, "times Y"), Number(-20, 20, "EV")

    def read(self, given: Any) -> Exposure:
        if isinstance(given, Exposure):
            return given
        if given == "auto":
            return Exposure(None)
        if given == "camera":
            return Exposure(1.0, stated=True)
        text = str(given)
        if text.lower().endswith("ev"):
            return Exposure(None, self.stops.read(text[:-2].rstrip()))
        try:
            factor = self.factor.read(text)
        except ValueError as error:
            raise ValueError(f"{error}, auto, camera, or stops from it such as -1EV") from None
        if text.startswith("+"):  # a factor has no sign: stops may be meant
            raise ValueError(f"{text} may be a factor or stops; give {text[1:]} (times Y), or {text}EV (brighter than auto)")
        return Exposure(factor)


class FrameRange(Reader):
    """FROM-TO[xSTEP], numbers of frames."""

    number, step = Number(0, 10**18 - 1, whole=True), Number(1, 10**18 - 1, "frames", whole=True)  # may hold microseconds

    def read(self, given: Any) -> range:
        if isinstance(given, range):
            return given
        match = re.fullmatch(r"(\d+)(?:-(\d+))?(?:x(\d+))?", str(given), re.ASCII)
        if not match:
            raise ValueError(f'"{shortened(str(given))}" is not FROM-TO[xSTEP], such as 1-500 or 1-500x2')
        first, last = self.number.read(match[1]), self.number.read(match[2] or match[1])
        step = self.step.read(match[3] or "1")
        if last < first:
            raise ValueError(f"{given} holds no frame; give the lower number first")
        return range(first, last + 1, step)


class Rate(Reader):
    """Frames a second, a number or a fraction, as videos hold it."""

    number, part = Number(0.001, 1000, "frames/s"), Number(1, 10**12, whole=True)

    def read(self, given: Any) -> Fraction | None:
        from l3cli.io.video import storable_rate

        above, slash, below = str(given).partition("/")
        if not slash:
            return storable_rate(Fraction(self.number.read(above)))
        rate = Fraction(self.part.read(above), self.part.read(below))
        self.number.read(float(rate))
        return storable_rate(rate)


class PackingName(Reader):
    """Name of a packing, in upper or lower case."""

    def read(self, given: Any) -> str:
        packing = packing_named(str(given))
        if packing is None:
            raise ValueError(f'"{shortened(str(given))}" is unknown; {suggestion(str(given), PACKINGS)}')
        return packing.name


PIXELS = Number(1, 1_000_000, "pixels", whole=True)


@options
class RenderOptions(ForceOptions, SchedulerOptions, DeviceOptions, BackendOptions):
    """Options of l3 render."""

    format: str = option(
        "png", "Suffix of the files in a folder; of a video, each INPUT becomes one.", metavar="SUFFIX", was="suffix"
    )
    frames: Given[range | str | None, range | None] = option(
        None, "Numbers of the frames to render.", FrameRange(), metavar="FROM-TO[xSTEP]"
    )
    dataset: str | None = option(None, "Frames of an HDF5 input [default: its only stack].", metavar="NAME")
    fps: Given[Fraction | float | str | None, Fraction | None] = option(
        None, "Frames a second, 25 or 30000/1001 [default: the input's or 30].", Rate(), metavar="RATE", was="rate"
    )
    codec: Literal["h264", "h265", "ffv1", "prores"] | None = option(
        None, "Codec of a video [default: .mp4 h264, .mov prores, .mkv ffv1]."
    )
    crf: float | None = option(
        None, "Rate factor of h264, h265; lower is better [default: the encoder's].", Number(0, 51), metavar="0…51"
    )
    preset: Preset = option("veryfast", f"Effort of h264, h265: {', '.join(get_args(Preset))}.", metavar="NAME")
    exposure: Given[Exposure | float | str | None, Exposure] = option(
        "auto",
        "Factor of Y; what it brings to 1 is shown white. +1EV: twice as bright as auto. camera: as the file states.",
        ExposureReader(),
        metavar="auto|camera|VALUE|±NEV",
    )
    deflicker: bool = option(
        False,
        "Sequences only: take off the flicker of light on mains of 50 or 60 Hz. The rate (‹fps›) must be the camera's.",
    )
    tone: Literal["aces"] | None = option(
        None,
        "Tone curve: aces, Narkowicz's fit (2016) of the ACES film curve, to 2.9 EV above white [default: linear to white].",
    )
    white: str | None = option(
        None,
        "Scene white shown neutral: light, chromaticity, multipliers of the channels, the table's, the file's, estimated, a "
        "ColorChecker's, a grey's pixels [default: the file's where a camera's raw files state it, else the table's].",
        metavar="NAME|x,y|R,G,B|table|camera|auto|chart|ROW,COL[,SIZE]",
    )
    space: Literal["srgb", "display-p3", "rec2020", "acescg", "xyz"] | None = option(
        None, "Colour space [default: srgb; of .exr and 32 bits the table's outputs as they are]."
    )
    remosaic: Literal["bayer"] | None = option(None, "Mosaic of a .dng [default: all three channels at every pixel].")
    bits: Literal[8, 16, 32] = option(8, "Bits a value of a picture; 32: linear, floating point (.tif).")
    black_level: float | None = option(
        None, "Black level of the inputs [default: the file's or the table's].", LEVEL, metavar="DN"
    )
    white_level: float | None = option(
        None, "White level of the inputs [default: the file's or table's].", LEVEL, metavar="DN"
    )
    exposure_time: float | None = option(
        None,
        "Exposure time of the inputs, for subtracting dark current [default: the file's or the training's].",
        Number(0, 1e5, "s"),
        metavar="SECONDS",
    )
    gain: float | None = option(
        None,
        "Analog gain of the inputs over that of the table's camera [default: by the file's ISO speed, else estimated].",
        GAIN,
        metavar="TIMES",
    )
    gains: OnePath = option(
        None,
        "Text file of the gain of each frame of a sequence, a line each, in their order; instead of ‹gain›.",
        metavar="FILE",
    )
    dark: Given[Name | Sequence[Name], tuple[Path, ...]] = option(
        (),
        "Dark frames of the same exposure time, files or a sequence; their mean is subtracted. May be repeated.",
        metavar="FRAME",
        several=True,
    )
    camera: OnePath = option(
        None, "Camera model, or table of one, whose defects and flat field are corrected.", metavar="CAMERA.h5"
    )
    hot: Literal["auto", "off"] = option("off", "Hot pixels that no camera model lists: correct them in each frame.")
    phase: Given[PAIR | str | None, PAIR | None] = option(
        None, "CFA site of the inputs' first pixel, from 0.", SITE, metavar="ROW,COL"
    )
    opcodes: Literal["leave"] | None = option(
        None, "Of a DNG: leave out the opcodes, such as a lens warp, that it demands and l3 does not carry out."
    )
    size: Given[PAIR | str | None, PAIR | None] = option(
        None, "Pixels of headerless inputs [default: the table's].", Pair("ROWSxCOLS", "x", PIXELS), metavar="ROWSxCOLS"
    )
    packing: str | None = option(
        None,
        "Packing of headerless inputs: u16, u8, MIPI's raw10 and raw12, or a PFNC name such as Mono10p, Mono12Packed, "
        "BayerRG8, whose array is checked [default: .raw10 and .raw12 MIPI, else u16].",
        PackingName(),
        metavar="NAME",
    )
    byte_order: Literal["little", "big"] | None = option(
        None, "Byte order of 16-bit values of headerless inputs [default: little]."
    )
    skip: int = option(
        0,
        "Bytes before the first frame of headerless inputs, such as a header.",
        Number(0, 10**12, "bytes", whole=True),
        metavar="BYTES",
    )
    stride: int | None = option(
        None, "Bytes from row to row [default: no padding].", Number(1, 100_000_000, "bytes", whole=True), metavar="BYTES"
    )
    uncertainty: OnePath = option(
        None,
        "Of one frame, also write there the standard deviation that noise leaves in each output, and a mask (.exr).",
        Output(),
        metavar="FILE",
        bytes=False,
    )
    temporal: bool = option(False, "Frames follow one another in time: blend each with what is not noise of those before.")
    shard: Given[PAIR | str | None, PAIR | None] = option(
        None,
        "Render only part I of N, from 1, of a sequence, to the same pictures as a run over all of it.",
        Shard(),
        metavar="I/N",
        bytes=False,
    )
    skip_bad: bool = option(False, "Leave out missing and broken frames; exit code 1 if there were any.", bytes=False)
    resume: bool = option(
        False,
        "Continue a sequence of pictures where a run was stopped; of many clips render what is new or changed.",
        bytes=False,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.gain is not None and self.gains is not None:
            raise RecipeError("‹gain› is that of all frames, ‹gains› that of each; leave one out")
