"""Limits on the size of inputs, and the environment variables that set these limits.

Sizes are checked before memory is allocated. Files are decoded in a separate process with limited time and memory, unless
the environment variable L3_TRUST is set.
"""

import contextlib
import os
import resource
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from math import prod
from pathlib import Path

from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.system.files import naming, open_regular
from l3cli.system.text import NoSuchNumber, Quantity

# Environment variables that limit BLAS libraries to one thread.
ONE_BLAS_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
MEGAPIXELS = "L3_MEGAPIXELS"  # environment variable: maximum size of a picture or frame, in megapixels
USUAL_MEGAPIXELS = 400.0
PICTURE = Quantity(0.0001, 1e6, "megapixels")
VALUES_A_PIXEL = 3  # maximum decoded size of a file: this many 32-bit values for each pixel of the largest permitted picture
VALUE_BYTES = 4
SECONDS = "L3_DECODE_SECONDS"  # environment variable: maximum CPU time for decoding a file, in s
USUAL_SECONDS = 60.0
TRUST = "L3_TRUST"  # environment variable: decode files in this process, without limits on time and memory
YES, NO = ("1", "true", "yes", "on", "y", "t"), ("", "0", "false", "no", "off", "n", "f")
LIBRARIES, A_CORE = 1 << 30, 16 << 20  # address space that libraries need, in bytes: base amount, and extra per core
MOST_TEXT = 64 << 20  # maximum size of a recipe, measurement file, CSV table or header, in bytes


def most_pixels() -> int:
    """Return the maximum number of pixels in a picture or frame. Raises RecipeError if L3_MEGAPIXELS is invalid."""
    return int(setting(MEGAPIXELS, PICTURE, USUAL_MEGAPIXELS) * 1e6)


def decode_seconds() -> float:
    """Return the maximum CPU time for decoding a file, in s. Raises RecipeError if L3_DECODE_SECONDS is invalid."""
    return setting(SECONDS, Quantity(0.1, 1e6, "s"), USUAL_SECONDS)


def require_settings() -> None:
    """Raise RecipeError if one of this module's environment variables is invalid, even if the command does not use it."""
    most_pixels(), decode_seconds(), trusted()


def setting(name: str, range_: Quantity, usual: float) -> float:
    """Return the number in the environment variable `name`, or `usual` if the variable is empty or unset.

    Raises RecipeError if the variable does not contain a number within `range_`.
    """
    text = os.environ.get(name, "")
    try:
        return range_.read(text) if text else usual
    except NoSuchNumber as error:
        raise RecipeError(f"{name}: {error}; correct or unset the environment variable (default {usual:g})") from None


def most_bytes() -> int:
    """Return the maximum size of a file's decoded content, in bytes."""
    return VALUES_A_PIXEL * VALUE_BYTES * most_pixels()


def require_picture(name: str, rows: int, cols: int, values: int = 1) -> None:
    """Raise InputFileError if a picture with `values` values per pixel is too large.

    `name` is the file name for the message.
    """
    if rows * cols > most_pixels() or rows * cols * values > VALUES_A_PIXEL * most_pixels():
        raise InputFileError(
            f"{name} has {rows}×{cols} pixels of {values} value{'s' * (values != 1)}, but the limit is "
            f"{most_pixels() / 1e6:g} megapixels of {VALUES_A_PIXEL} values; if the size is correct, increase the "
            f"environment variable {MEGAPIXELS}"
        )


def require_values(name: str, shape: Iterable[int], value_bytes: int = VALUE_BYTES) -> None:
    """Raise InputFileError if an array of this shape, with `value_bytes` bytes per value, is larger than `most_bytes`."""
    shape = tuple(int(length) for length in shape)
    if prod(shape) * max(value_bytes, 1) > most_bytes():
        lengths = "×".join(map(str, shape))
        raise InputFileError(
            f"{name} has {lengths} values of {value_bytes} bytes, more than {most_bytes() / 1e9:.3g} GB; "
            f"if the size is correct, increase the environment variable {MEGAPIXELS}"
        )


def require_address_space() -> None:
    """Raise L3Error if the address space (ulimit -v) is so small that libraries would abort or hang."""
    needed = LIBRARIES + A_CORE * (os.cpu_count() or 1)
    allowed = resource.getrlimit(resource.RLIMIT_AS)[0]
    if allowed != resource.RLIM_INFINITY and allowed < needed:
        raise L3Error(
            f"the address space is limited to {allowed >> 20} MB, but libraries need {needed >> 20} MB; raise ulimit -v"
        )


def read_bounded(path: Path, cure: str = "use a text file") -> bytes:
    """Read a text file of at most MOST_TEXT bytes.

    Raises InputFileError if the file is larger or cannot be read. If it cannot be read, the message ends with `cure`, the
    suggested correction.
    """
    with naming(path, cure), open_regular(path, cure) as stream:
        content = stream.read(MOST_TEXT + 1)
    if len(content) > MOST_TEXT:
        raise InputFileError(f"{path} is larger than {MOST_TEXT >> 20} MB; use a text file")
    return content


def trusted() -> bool:
    """Return whether L3_TRUST allows this process to decode input files. Raises RecipeError if L3_TRUST is invalid."""
    word = os.environ.get(TRUST, "").strip().lower()
    if word not in YES + NO:
        raise RecipeError(f'{TRUST} is "{word}", which is neither yes nor no; set it to 1 or 0, or unset it')
    return word in YES


def trust() -> AbstractContextManager[None]:
    """Context manager that sets L3_TRUST for this process and for processes that start during the block."""
    return environment({TRUST: "1"})


@contextlib.contextmanager
def environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Context manager that sets environment variables, also for processes that start during the block."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def without_plots() -> None:
    """Prevent colour-science from importing matplotlib and pandas, which l3 does not use.

    They would double the CPU time of the import from 2.4 s to 4.8 s on a slow core, in every process that simulates or
    trains. In a process that cannot write files, matplotlib would also fail if it has no cache folder yet.
    """
    for name in ("matplotlib", "pandas"):
        sys.modules.setdefault(name, None)  # type: ignore[arg-type] # None makes the import fail
