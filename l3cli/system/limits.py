"""Limits of what an input may ask for, checked on its header's claims before anything is allocated; and who is trusted."""

import contextlib
import os
import resource
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from math import prod
from pathlib import Path

from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.system.files import naming, open_regular
from l3cli.system.text import NoSuchNumber, Quantity

ONE_BLAS_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")  # environment
MEGAPIXELS = "L3_MEGAPIXELS"  # environment variable: the most pixels of a picture or frame, in millions
USUAL_MEGAPIXELS = 400.0
PICTURE = Quantity(0.0001, 1e6, "megapixels")
VALUES_A_PIXEL = 3  # what a file holds in all may be so many values of 32 bits for each pixel that a picture may have
VALUE_BYTES = 4
SECONDS = "L3_DECODE_SECONDS"  # environment variable: processor time for decoding one file
USUAL_SECONDS = 60.0
TRUST = "L3_TRUST"  # environment variable: decode foreign files in this process, without limits of time and memory
YES, NO = ("1", "true", "yes", "on", "y", "t"), ("", "0", "false", "no", "off", "n", "f")
LIBRARIES, A_CORE = 1 << 30, 16 << 20  # bytes of address space, and for the threads of each core
MOST_TEXT = 64 << 20  # bytes of a recipe, a measurement file, a CSV table, a header


def most_pixels() -> int:
    """Return the pixels (rows × columns) that one picture or frame may have."""
    return int(setting(MEGAPIXELS, PICTURE, USUAL_MEGAPIXELS) * 1e6)


def decode_seconds() -> float:
    """Return the processor time (s) that decoding one file may take."""
    return setting(SECONDS, Quantity(0.1, 1e6, "s"), USUAL_SECONDS)


def require_settings() -> None:
    """Raise RecipeError if an environment variable above has no meaning, even where nothing depends on it."""
    most_pixels(), decode_seconds(), trusted()


def setting(name: str, range_: Quantity, usual: float) -> float:
    """Return the number in an environment variable, `usual` where it is not set; RecipeError if it is none in its range."""
    text = os.environ.get(name, "")
    try:
        return range_.read(text) if text else usual
    except NoSuchNumber as error:
        raise RecipeError(f"{name}: {error}; unset it for the usual {usual:g}") from None


def most_bytes() -> int:
    """Return the bytes that the content of one file may have in memory."""
    return VALUES_A_PIXEL * VALUE_BYTES * most_pixels()


def require_picture(name: str, rows: int, cols: int, values: int = 1) -> None:
    """Raise InputFileError unless a picture of so many `values` a pixel is no larger than inputs may be."""
    if rows * cols > most_pixels() or rows * cols * values > VALUES_A_PIXEL * most_pixels():
        raise InputFileError(
            f"{name} claims {rows}×{cols} pixels of {values} values, more than {most_pixels() / 1e6:g} megapixels of "
            f"{VALUES_A_PIXEL}; if they are really there, raise {MEGAPIXELS}"
        )


def require_values(name: str, shape: Iterable[int], value_bytes: int = VALUE_BYTES) -> None:
    """Raise InputFileError unless an array of `shape` is no larger than the content of a file may be."""
    shape = tuple(int(length) for length in shape)
    if prod(shape) * max(value_bytes, 1) > most_bytes():
        claimed = "×".join(map(str, shape))
        raise InputFileError(
            f"{name} claims {claimed} values of {value_bytes} bytes, more than {most_bytes() / 1e9:.3g} GB; "
            f"if they are really there, raise {MEGAPIXELS}"
        )


def require_address_space() -> None:
    """Raise L3Error if the process may have too little (ulimit -v) for the libraries: where one gets none it ends the
    program, hangs, or sends it signals."""
    needed = LIBRARIES + A_CORE * (os.cpu_count() or 1)
    allowed = resource.getrlimit(resource.RLIMIT_AS)[0]
    if allowed != resource.RLIM_INFINITY and allowed < needed:
        raise L3Error(
            f"{allowed >> 20} MB of address space are allowed (ulimit -v), libraries need {needed >> 20} MB; raise the limit"
        )


def read_bounded(path: Path, cure: str = "give a text file") -> bytes:
    """Return all bytes of a text file. InputFileError, with this cure, if there is no file, one larger than texts are, or
    its storage fails."""
    with naming(path, cure), open_regular(path, cure) as stream:
        content = stream.read(MOST_TEXT + 1)
    if len(content) > MOST_TEXT:
        raise InputFileError(f"{path} is larger than {MOST_TEXT >> 20} MB; give a text file")
    return content


def trusted() -> bool:
    """Return whether foreign files are decoded in this process. RecipeError if what the environment says of it is
    unclear."""
    word = os.environ.get(TRUST, "").strip().lower()
    if word not in YES + NO:
        raise RecipeError(f'{TRUST}="{word}" is neither yes nor no; unset it or give 1 or 0')
    return word in YES


def trust() -> AbstractContextManager[None]:
    """Decode foreign files, within the block and in processes started there, without a child."""
    return environment({TRUST: "1"})


@contextlib.contextmanager
def environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Hold environment variables at these values within the block, and for processes started there."""
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
