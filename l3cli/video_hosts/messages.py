"""Errors as a host reports them."""

import re

from l3cli.errors import L3Error


def format_error(error: Exception, dash: str = "_") -> str:
    """Return an error as one line, with a host's names of parameters: words joined by `dash`."""
    text = str(error) if isinstance(error, L3Error) else f"{type(error).__name__}: {error}"
    return re.sub("‹(\\w+)›", lambda match: match[1].replace("_", dash), " ".join(text.split()))
