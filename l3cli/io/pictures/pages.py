"""A sequence as the pages of one TIFF, written as they come, so that memory does not grow with their number."""

import contextlib
import errno
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from l3cli.io.pictures.icc import icc_profile
from l3cli.io.pictures.registry import Picture
from l3cli.io.tags import shot_entries
from l3cli.system.files import atomic_output

PAGED = (".tif", ".tiff")
ROOM = 4_000_000_000  # bytes of pixels in a file of 32-bit offsets


class Pages:
    """The pages of a file that is being written."""

    def __init__(self, path: Path, count: int | None) -> None:
        """Take the file, and the `count` of pages that there will be, None: unknown."""
        self._path, self._count = path, count
        self._file: Any = None

    def write(self, picture: Picture) -> None:
        """Append a page."""
        import tifffile

        pixels, label = picture.pixels, picture.label
        if self._file is None:
            is_big = self._count is None or self._count * pixels.nbytes > ROOM
            self._file = tifffile.TiffWriter(self._path, bigtiff=is_big, byteorder="<")
        rows, _, values = pixels.shape
        try:
            self._file.write(
                pixels if values > 1 else pixels[..., 0],
                photometric="rgb" if values == 3 else "minisblack",
                planarconfig="contig" if values > 1 else None,
                rowsperstrip=rows,
                metadata=None,
                software=label.software,
                description=label.description,
                iccprofile=icc_profile(picture.space) if picture.space else None,
                extratags=shot_entries(label.shot, label.exposure),
                contiguous=False,
            )
        except OSError as error:
            # Of an array that does not fit numpy says only how much of it has been written.
            raise OSError(error.errno or errno.ENOSPC, os.strerror(error.errno or errno.ENOSPC)) from error

    def close(self) -> None:
        if self._file is not None:
            self._file.close()


@contextlib.contextmanager
def new_pages(path: Path, count: int | None) -> Iterator[Pages]:
    """Yield the pages of a new file, which appears whole or not at all."""
    with atomic_output(path) as temporary, contextlib.closing(Pages(temporary, count)) as pages:
        yield pages
