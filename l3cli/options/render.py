"""Options for l3 render."""

import re
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

from l3cli.errors import RecipeError, shortened
from l3cli.frames.packings import packing_named, unknown_packing
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
    """Parsed value of the option `exposure`."""

    factor: float | None  # factor by which Y is multiplied; None for automatic exposure
    stops: float = 0.0  # EV relative to the automatic exposure; positive values brighten the pictures
    stated: bool = False  # whether `factor` also multiplies the exposure stated in each file (BaselineExposure)


class ExposureReader(Reader):
    """Exposure of the rendered pictures.

    The value is a factor for Y, "auto" for automatic exposure, an exposure relative to "auto" such as "+1EV", or "camera"
    for the exposure stated in each file.
    """

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
            raise ValueError(f"{error}; other values are auto, camera, and EV relative to auto, such as -1EV") from None
        if text.startswith("+"):  # nobody writes a factor with a plus sign, so the user may have meant EV
            raise ValueError(
                f"{text} is ambiguous; write {text}EV for {text[1:]} EV more than auto, or {text[1:]} to multiply Y by "
                "this factor"
            )
        return Exposure(factor)


class FrameRange(Reader):
    """Range of frame numbers FROM-TO[xSTEP], such as "1-500x2", or a single frame number."""

    # The range is this large because frame numbers may be timestamps in µs.
    number, step = Number(0, 10**18 - 1, whole=True), Number(1, 10**18 - 1, "frames", whole=True)

    def read(self, given: Any) -> range:
        if isinstance(given, range):
            return given
        match = re.fullmatch(r"(\d+)(?:-(\d+))?(?:x(\d+))?", str(given), re.ASCII)
        if not match:
            raise ValueError(f'"{shortened(str(given))}" does not have the form FROM-TO[xSTEP], such as 1-500 or 1-500x2')
        first, last = self.number.read(match[1]), self.number.read(match[2] or match[1])
        step = self.step.read(match[3] or "1")
        if last < first:
            raise ValueError(f"{given} is an empty range; write the lower number first")
        return range(first, last + 1, step)


class Rate(Reader):
    """Frame rate in frames/s, as a number or as a fraction such as "30000/1001".

    The rate is rounded to a fraction that video files can store.
    """

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
    """Name of a pixel packing, in upper or lower case."""

    def read(self, given: Any) -> str:
        packing = packing_named(str(given))
        if packing is None:
            raise ValueError(unknown_packing(str(given)))
        return packing.name


PIXELS = Number(1, 1_000_000, "pixels", whole=True)


@options
class RenderOptions(ForceOptions, SchedulerOptions, DeviceOptions, BackendOptions):
    """Options for l3 render. Only one of `gain` and `gains` may be set."""

    format: str = option(
        "png",
        "Output folders only: suffix of the pictures. If it is the suffix of a video, each INPUT becomes one video.",
        metavar="SUFFIX",
    )
    frames: Given[range | str | None, range | None] = option(
        None, "Sequences only: numbers of the frames to render [default: all].", FrameRange(), metavar="FROM-TO[xSTEP]"
    )
    dataset: str | None = option(
        None,
        "HDF5 and MATLAB files only: name of the dataset with the frames [default: the only dataset with frames].",
        metavar="NAME",
    )
    fps: Given[Fraction | float | str | None, Fraction | None] = option(
        None,
        "Sequences only: frame rate in frames/s, such as 25 or 30000/1001 [default: from the input, otherwise 30].",
        Rate(),
        metavar="RATE",
    )
    codec: Literal["h264", "h265", "ffv1", "prores"] | None = option(
        None, "Videos only: codec [default: h264 for .mp4, prores for .mov, ffv1 for .mkv]."
    )
    crf: float | None = option(
        None,
        "h264 and h265 only: constant rate factor. Lower values mean better quality [default: the encoder's default].",
        Number(0, 51),
        metavar="0…51",
    )
    preset: Preset = option(
        "veryfast", f"h264 and h265 only: speed of the encoder: {', '.join(get_args(Preset))}.", metavar="NAME"
    )
    exposure: Given[Exposure | float | str | None, Exposure] = option(
        "auto",
        "VALUE: multiply Y by this number, where Y = 1 is display white. auto: show the 99th percentile of Y as white. "
        "+1EV: twice as bright as auto. camera: use the exposure in the file.",
        ExposureReader(),
        metavar="auto|camera|VALUE|±NEV",
    )
    deflicker: bool = option(
        False,
        "Sequences only: remove the flicker of lamps on 50 or 60 Hz mains. ‹fps› must be the frame rate of the camera.",
    )
    tone: Literal["aces"] | None = option(
        None,
        "Tone curve. aces: Narkowicz's approximation (2016) of the ACES film curve, which retains detail up to 2.9 EV above "
        "white [default: linear, clipped at white].",
    )
    white: str | None = option(
        None,
        "White of the scene, which becomes neutral: an illuminant, a chromaticity, one multiplier per channel, the white of "
        "the table (table) or of the file (camera), an estimate from the frame (auto), the white of a ColorChecker (chart), "
        "or a grey area of the picture [default: camera for camera raw files with a white balance, otherwise table].",
        metavar="NAME|x,y|R,G,B|table|camera|auto|chart|ROW,COL[,SIZE]",
    )
    show: Literal["dolp", "aolp", "stokes"] | None = option(
        None,
        "Polarisation cameras only: show the degree of linear polarisation (dolp), its angle (aolp), or all Stokes "
        "parameters (stokes) in colours, with a colour bar [default: the intensity or colour picture].",
    )
    space: Literal["srgb", "display-p3", "rec2020", "acescg", "xyz"] | None = option(
        None, "Colour space [default: srgb, but the unchanged outputs of the table for .exr files and 32 bits]."
    )
    remosaic: Literal["bayer"] | None = option(
        None, "DNG output only: write a Bayer mosaic [default: three channels at every pixel]."
    )
    bits: Literal[8, 16, 32] = option(8, "Bits per value of a picture. 32: linear floating point (.tif).")
    black_level: float | None = option(
        None, "Black level of the inputs [default: from the file, otherwise as in the table].", LEVEL, metavar="DN"
    )
    white_level: float | None = option(
        None, "White level of the inputs [default: from the file, otherwise as in the table].", LEVEL, metavar="DN"
    )
    exposure_time: float | None = option(
        None,
        "Exposure time of the inputs, to subtract the dark current [default: from the file, otherwise as in training].",
        Number(0, 1e5, "s"),
        metavar="SECONDS",
    )
    gain: float | None = option(
        None,
        "Analog gain of the inputs, relative to the gain of the table's camera [default: from the ISO speed in the file, "
        "otherwise estimated].",
        GAIN,
        metavar="TIMES",
    )
    gains: OnePath = option(
        None,
        "Sequences only, instead of ‹gain›: text file with the gain of each frame, one per line.",
        metavar="FILE",
    )
    dark: Given[Name | Sequence[Name], tuple[Path, ...]] = option(
        (),
        "Dark frames (files or a sequence) with the same exposure time. Their mean is subtracted. May be repeated.",
        metavar="FRAME",
        several=True,
    )
    camera: OnePath = option(
        None,
        "Camera model, or table that contains a camera model. l3 corrects the defective pixels, the shading, and "
        "the polarisers of single pixels that the model describes.",
        metavar="CAMERA.h5",
    )
    hot: Literal["auto", "off"] = option(
        "off", "Find and correct hot pixels in each frame, in addition to the pixels that the camera model lists."
    )
    phase: Given[PAIR | str | None, PAIR | None] = option(
        None,
        "CFA row and column, from 0, of the inputs' first pixel [default: from the file, otherwise 0,0].",
        SITE,
        metavar="ROW,COL",
    )
    opcodes: Literal["leave"] | None = option(
        None, "DNG files only: ignore lens warps, and required opcodes that l3 does not support."
    )
    size: Given[PAIR | str | None, PAIR | None] = option(
        None,
        "Headerless files only: number of rows and columns [default: as in the table].",
        Pair("ROWSxCOLS", "x", PIXELS),
        metavar="ROWSxCOLS",
    )
    packing: str | None = option(
        None,
        "Headerless files only: packing of the values. Use u16, u8, raw10 or raw12 (MIPI), or a PFNC name such as Mono10p, "
        "Mono12Packed, BayerRG8 or PolarizeMono12p [default: MIPI for .raw10 and .raw12, otherwise u16].",
        PackingName(),
        metavar="NAME",
    )
    byte_order: Literal["little", "big"] | None = option(
        None, "Headerless files only: byte order of 16-bit values [default: little]."
    )
    skip: int = option(
        0,
        "Headerless files only: bytes to skip before the first frame.",
        Number(0, 10**12, "bytes", whole=True),
        metavar="BYTES",
    )
    stride: int | None = option(
        None,
        "Headerless files only: bytes from the start of a row to the start of the next row [default: no padding].",
        Number(1, 100_000_000, "bytes", whole=True),
        metavar="BYTES",
    )
    uncertainty: OnePath = option(
        None,
        "Single frames only: also write an .exr file with the standard deviation of each output due to noise, and a mask.",
        Output(),
        metavar="FILE",
        bytes=False,
    )
    temporal: bool = option(
        False, "Sequences only: reduce noise by blending each frame with previous frames wherever the scene is unchanged."
    )
    shard: Given[PAIR | str | None, PAIR | None] = option(
        None,
        "Sequences only: render only shard I (1 to N). All shards together produce the same pictures as one run.",
        Shard(),
        metavar="I/N",
        bytes=False,
    )
    skip_bad: bool = option(False, "Skip missing and damaged frames, and list them.", bytes=False)
    resume: bool = option(
        False,
        "Continue an interrupted run on a sequence of pictures. With several clips, render only new or changed clips.",
        bytes=False,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.gain is not None and self.gains is not None:
            raise RecipeError("‹gain› sets one gain for all frames, and ‹gains› sets one gain per frame; remove one option")
