"""Plugins for video programs: a VapourSynth filter and a GStreamer element (docs/video.md#vapoursynth).

This module must not import numpy or OpenCL, because GStreamer crashes if numpy or OpenCL is loaded before GStreamer.
"""

import re

from l3cli.errors import L3Error


def format_error(error: Exception, dash: str = "_") -> str:
    """Convert an exception to one line of text.

    If the exception is not an L3Error, the text starts with the name of its class. In parameter names such as ‹black_level›,
    the angle quotes are removed, and each underscore is replaced by `dash`.
    """
    text = str(error) if isinstance(error, L3Error) else f"{type(error).__name__}: {error}"
    return re.sub("‹(\\w+)›", lambda match: match[1].replace("_", dash), " ".join(text.split()))
