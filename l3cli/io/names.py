"""Names of files for libraries of others that take UTF-8 alone."""

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

_links: dict[Path, str] = {}  # by absolute path: those of `linked`


@contextlib.contextmanager
def named_in_utf8(path: Path) -> Iterator[str]:
    """Yield a name of the file: as given, or that of a link where it has bytes that are no UTF-8."""
    try:
        yield os.fsencode(path).decode()
    except UnicodeDecodeError:
        with linked(path):
            yield _links[path.absolute()]


@contextlib.contextmanager
def linked(path: Path) -> Iterator[None]:
    """Within the block, also in processes forked there, a file whose name is no UTF-8 has the link that `named_in_utf8`
    needs: a process that decodes may make none."""
    try:
        os.fsencode(path.absolute()).decode()
        has_link = True
    except UnicodeDecodeError:
        has_link = path.absolute() in _links
    if has_link:
        yield
        return
    with tempfile.TemporaryDirectory(prefix="l3-name-") as folder:
        link = Path(folder, "file").with_suffix(path.suffix)
        link.symlink_to(path.absolute())
        _links[path.absolute()] = str(link)
        try:
            yield
        finally:
            del _links[path.absolute()]
