"""The GStreamer element l3render, which renders raw frames to RGB.

    from l3cli.video_hosts.gstreamer import register

    register()
    pipeline = Gst.parse_launch("… ! l3render table=table.h5 ! videoconvert ! …")

Programs such as gst-launch-1.0 load the element through plugins/python/l3render.py if the folder `plugins` is in GStreamer's
search path (docs/video.md#gstreamer).
"""

import sys
from fractions import Fraction
from typing import Any

from l3cli.errors import L3Error, RecipeError
from l3cli.video_hosts import format_error

INSTALL = "GStreamer's Python module is missing; install it (Debian: python3-gst-1.0 and gir1.2-gst-plugins-base-1.0)"

try:
    import gi

    for _namespace in ("Gst", "GstBase", "GstVideo"):
        gi.require_version(_namespace, "1.0")
    from gi.repository import GLib, GObject, Gst, GstBase, GstVideo
except (ImportError, ValueError) as _missing:
    raise L3Error(INSTALL) from _missing
if not Gst.is_initialized():
    Gst.init(None)  # must precede the definition of classes derived from GStreamer

NAME = "l3render"
ORDERS = ("rggb", "bggr", "grbg", "gbrg")
DEPTHS = ("", "10le", "12le", "14le", "16le")  # suffixes of video/x-bayer formats; GStreamer < 1.24 supports only 8 bits
MOSAICS = (  # caps of the input
    "video/x-raw, format=(string){ GRAY16_LE, GRAY8 }; "
    f"video/x-bayer, format=(string){{ {', '.join(order + depth for depth in DEPTHS for order in ORDERS)} }}"
)
BITS = {"RGB": 8, "RGBA64_LE": 16}  # bits per value of each output format
PICTURES = f"video/x-raw, format=(string){{ {', '.join(BITS)} }}, colorimetry=(string)sRGB"
SHARED = ("width", "height", "framerate", "pixel-aspect-ratio")  # fields that are equal in input and output caps
USUAL_RATE = Fraction(30)  # assumed frame rate (frames/s) of streams without one


def _pad(name: str, direction: Any, caps: str) -> Any:
    return Gst.PadTemplate.new(name, direction, Gst.PadPresence.ALWAYS, Gst.Caps.from_string(caps))


class L3Render(GstBase.BaseTransform):
    """GStreamer element that renders mosaics in DN, like `l3 render` for a sequence.

    The output is sRGB with 8 bits (RGB) or 16 bits (RGBA64_LE), depending on what the next element accepts. If an error
    occurs, for example because the frames do not fit the table, the element posts a one-line error message to the
    application, and the stream ends.
    """

    __gtype_name__ = "L3Render"
    __gstmetadata__ = (
        "L3 renderer",
        "Filter/Converter/Video",
        "Renders raw frames to RGB with a table from l3 train",
        "the l3cli authors",
    )
    __gsttemplates__ = (_pad("sink", Gst.PadDirection.SINK, MOSAICS), _pad("src", Gst.PadDirection.SRC, PICTURES))

    table = GObject.Property(type=str, default="", nick="Table", blurb="Transform table, a file that l3 train wrote")
    exposure = GObject.Property(
        type=float, default=0, minimum=0, maximum=1e9, blurb="Factor by which Y is multiplied, or 0 for automatic exposure"
    )
    white = GObject.Property(
        type=str, default="", blurb='Scene white: "D50", "x,y", "auto" or "ROW,COL"; empty for the table\'s white'
    )
    black_level = GObject.Property(
        type=float, default=-1, minimum=-1, maximum=65535, blurb="Black level in DN, or -1 for the table's black level"
    )
    white_level = GObject.Property(
        type=float, default=-1, minimum=-1, maximum=65535, blurb="White level in DN, or -1 for the table's white level"
    )
    phase = GObject.Property(
        type=str, default="", blurb='CFA site of the first pixel as "ROW,COL"; empty for the phase of the stream, or 0,0'
    )
    size = GObject.Property(type=str, default="", blurb='Frame size as "ROWSxCOLS", if it differs from the table\'s sensor')
    camera = GObject.Property(type=str, default="", blurb="Camera model for correcting defective pixels and shading")
    backend = GObject.Property(type=str, default="opencl", blurb="Renderer: opencl or reference")
    device = GObject.Property(type=str, default="", blurb="OpenCL device: its number, or part of its name")
    temporal = GObject.Property(type=bool, default=False, blurb="Whether to reduce noise by filtering frames over time")

    def __init__(self) -> None:
        super().__init__()
        self._mosaics: Any = None  # l3cli.api.frames.Mosaics while the element runs, otherwise None
        self._reported = ""  # latest error message; it is posted only once, even if GStreamer tries several caps
        self._picture: Any = None  # function that renders the next frame
        self._source: Any = None  # memory layout of the input frames
        self._target: Any = None  # memory layout of the output frames

    # ------------------------------------------------------------------------------------------------- start and stop

    def do_start(self) -> bool:
        self._reported = ""
        try:
            self._mosaics = self._opened()
        except Exception as error:  # GStreamer would print a traceback and continue
            return self._failed(error)
        return True

    def do_stop(self) -> bool:
        self._mosaics = self._picture = None
        return True

    def _opened(self) -> Any:
        try:
            from l3cli.api.frames import Mosaics, pair
        except ImportError as error:
            version = f"{sys.version_info.major}.{sys.version_info.minor}"
            raise L3Error(
                f"GStreamer uses Python {version}, which cannot import l3cli ({error}); install l3cli for Python {version}"
            ) from error
        if not self.table:
            raise RecipeError("the property table is empty; set it to a file from l3 train")
        return Mosaics(
            self.table,
            black_level=None if self.black_level < 0 else self.black_level,
            white_level=None if self.white_level < 0 else self.white_level,
            phase=pair(self.phase, ",", "phase"),
            size=pair(self.size, "x", "size"),
            camera=self.camera or None,
            backend=self.backend,
            device=self.device or None,
        )

    # ------------------------------------------------------------------------------------------- negotiation of caps

    def do_transform_caps(self, direction: Any, caps: Any, within: Any) -> Any:
        template = Gst.Caps.from_string(PICTURES if direction == Gst.PadDirection.SINK else MOSAICS)
        made = Gst.Caps.new_empty()
        for this in (caps.get_structure(number) for number in range(caps.get_size())):
            for number in range(template.get_size()):
                other = template.get_structure(number).copy()
                for name in filter(this.has_field, SHARED):
                    other.set_value(name, this.get_value(name))
                made.append_structure(other)
        return within.intersect_full(made, Gst.CapsIntersectMode.FIRST) if within else made

    def do_set_caps(self, incaps: Any, outcaps: Any) -> bool:
        try:
            self._source, self._target = _Layout(incaps), _Layout(outcaps)
            self._mosaics.require_size(*self._source.shape)
            bits = BITS[outcaps.get_structure(0).get_string("format")]
            shown = {"exposure": self.exposure or None, "white": self.white or None, "temporal": self.temporal}
            self._picture = self._mosaics.renderer.sequence(self._source.rate, bits=bits, **shown)
        except Exception as error:
            return self._failed(error)
        return True

    def do_transform_size(self, direction: Any, caps: Any, size: int, othercaps: Any) -> tuple[bool, int]:
        return True, _Layout(othercaps).nbytes

    def do_get_unit_size(self, caps: Any) -> tuple[bool, int]:
        return True, _Layout(caps).nbytes

    # -------------------------------------------------------------------------------------------------- rendering

    def do_transform(self, inbuf: Any, outbuf: Any) -> Any:
        try:
            with inbuf.map(Gst.MapFlags.READ) as read, outbuf.map(Gst.MapFlags.WRITE) as written:
                values = self._source.pixels(inbuf, read.data)[..., 0]
                picture = self._picture(self._mosaics.frame(values, self._source.order))
                pixels = self._target.pixels(outbuf, written.data)
                pixels[..., :3] = picture
                if pixels.shape[2] > 3:
                    pixels[..., 3] = 65535  # alpha: opaque
        except Exception as error:
            self._failed(error)
            return Gst.FlowReturn.ERROR
        return Gst.FlowReturn.OK

    def _failed(self, error: Exception) -> bool:
        """Post an error message to the application, unless it repeats the previous one. Return False."""
        text = format_error(error, "-")
        if text != self._reported:
            self._reported, code = text, Gst.ResourceError.FAILED
            self.post_message(Gst.Message.new_error(self, GLib.Error.new_literal(Gst.ResourceError.quark(), text, code), ""))
        return False


class _Layout:
    """Memory layout and frame rate (default USUAL_RATE) of a stream, from its caps.

    Raises RecipeError if the stream is interlaced.
    """

    def __init__(self, caps: Any) -> None:
        structure = caps.get_structure(0)
        form = structure.get_string("format")
        self.order: str | None = None  # Bayer order in the caps, such as "rggb", if any
        self.shape = structure.get_value("height"), structure.get_value("width")
        if structure.get_name() == "video/x-bayer":
            self.order, self.channels, self.dtype = form[:4], 1, "<u2" if form[4:] else "u1"
            self.stride, self.offset = -(-self.shape[1] * int(self.dtype[-1]) // 4) * 4, 0
            self.nbytes = self.stride * self.shape[0]
        else:
            info = GstVideo.VideoInfo.new_from_caps(caps)
            if info.interlace_mode != GstVideo.VideoInterlaceMode.PROGRESSIVE:
                raise RecipeError("the stream is interlaced; use a progressive stream")
            self.channels, self.dtype = info.finfo.n_components, "u1" if form in ("GRAY8", "RGB") else "<u2"
            self.stride, self.offset, self.nbytes = info.stride[0], info.offset[0], info.size
        found, above, below = structure.get_fraction("framerate")
        self.rate = Fraction(above, below) if found and above > 0 else USUAL_RATE

    def pixels(self, buffer: Any, content: Any) -> Any:
        """Return the frame in a buffer as an array (row, col, channel) without copying.

        The buffer's video metadata, if any, override the stride and offset from the caps. Raises RecipeError if the buffer
        is too small.
        """
        import numpy as np

        meta = GstVideo.buffer_get_video_meta(buffer)
        stride, offset = (meta.stride[0], meta.offset[0]) if meta else (self.stride, self.offset)
        pixel = np.dtype(self.dtype).itemsize * self.channels
        if offset + stride * (self.shape[0] - 1) + pixel * self.shape[1] > len(content):
            raise RecipeError(
                f"the buffer of {len(content)} bytes is too small for a frame of {self.shape[0]}×{self.shape[1]} pixels; "
                "correct the caps of the stream"
            )
        strides = stride, pixel, np.dtype(self.dtype).itemsize
        return np.ndarray((*self.shape, self.channels), self.dtype, content, offset, strides)


def register() -> None:
    """Register the element with GStreamer in this process."""
    Gst.Element.register(None, NAME, Gst.Rank.NONE, L3Render)
