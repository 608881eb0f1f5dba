"""Tables in video programs: a filter of VapourSynth, an element of GStreamer (docs/video.md#vapoursynth).

Nothing heavy is imported here: a GStreamer that finds numpy or OpenCL loaded before it crashes."""

import re

from l3cli.errors import L3Error


def format_error(error: Exception, dash: str = "_") -> str:
    """Return an error as one line, with a host's names of parameters: words joined by `dash`."""
    text = str(error) if isinstance(error, L3Error) else f"{type(error).__name__}: {error}"
    return re.sub("‹(\\w+)›", lambda match: match[1].replace("_", dash), " ".join(text.split()))
