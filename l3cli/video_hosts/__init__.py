"""Plugins for video programs: a VapourSynth filter and a GStreamer element (docs/video.md#vapoursynth).

This file must not import numpy or OpenCL, because GStreamer crashes if one of them is loaded before GStreamer.
"""

import re

from l3cli.errors import L3Error


def format_error(error: Exception, dash: str = "_") -> str:
    """Convert an error to one line of text.

    The type of the error precedes the text, except for errors of l3. In parameter names such as ‹black_level›, the quotation
    marks are removed and `dash` replaces the underscores.
    """
    text = str(error) if isinstance(error, L3Error) else f"{type(error).__name__}: {error}"
    return re.sub("‹(\\w+)›", lambda match: match[1].replace("_", dash), " ".join(text.split()))
