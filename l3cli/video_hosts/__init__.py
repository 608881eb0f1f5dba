"""Plugins for video programs: a VapourSynth filter and a GStreamer element (docs/video.md#vapoursynth).

No large libraries are imported here, because GStreamer crashes if numpy or OpenCL is loaded before it.
"""

import re

from l3cli.errors import L3Error


def format_error(error: Exception, dash: str = "_") -> str:
    """Return an error as one line, with parameter names as in the video program: words joined by `dash`."""
    text = str(error) if isinstance(error, L3Error) else f"{type(error).__name__}: {error}"
    return re.sub("‹(\\w+)›", lambda match: match[1].replace("_", dash), " ".join(text.split()))
