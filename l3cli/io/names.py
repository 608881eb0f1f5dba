"""Names of files for libraries of others that take UTF-8 alone."""

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def named_in_utf8(path: Path) -> Iterator[str]:
    """A name of the file: as given, or that of a link where it has bytes that are no UTF-8."""
    try:
        yield os.fsencode(path).decode()
    except UnicodeDecodeError:
        with tempfile.TemporaryDirectory(prefix="l3-name-") as folder:
            link = Path(folder, "file").with_suffix(path.suffix)
            link.symlink_to(path.absolute())
            yield str(link)
