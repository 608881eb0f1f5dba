"""Plugins for video programs: a VapourSynth filter and a GStreamer element (docs/video.md#vapoursynth).

This module must not import numpy or OpenCL, because GStreamer crashes if either is loaded first.
"""

import re

from l3cli.errors import L3Error


def format_error(error: Exception, dash: str = "_") -> str:
    """Format an exception as one line of text.

    The class name precedes the text unless the exception is an L3Error. Parameter names such as ‹black_level› lose their
    angle quotes, and `dash` replaces their underscores.
    """
    text = str(error) if isinstance(error, L3Error) else f"{type(error).__name__}: {error}"
    return re.sub("‹(\\w+)›", lambda match: match[1].replace("_", dash), " ".join(text.split()))
