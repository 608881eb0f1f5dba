"""Foreign files are decoded in an isolated process of limited time and memory: what the decoders of others stumble over can
end that process, never this one.

The process is started when the first file is read. It forks a worker for each file, which decodes what is asked of that file
confined to it (decoder_process.py), as far as the kernel can; when a worker dies so does the process, and the next file gets
a new one. Requests and answers are JSON; arrays come through a file in memory, checked against its size and copied, so
that nothing that a worker says is executed or believed here. Who trusts his files (`--trust`, or L3_TRUST=1) has them
decoded in the caller's process.
"""

import atexit
import contextlib
import functools
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from math import prod
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.system.files import require_regular, stamp
from l3cli.system.limits import MEGAPIXELS, ONE_BLAS_THREAD, SECONDS, TRUST, decode_seconds, most_bytes, trusted
from l3cli.system.locks import ThreadLock

PATIENCE = 5  # times the processor time that a file may take by the clock, on a slow disk
ROOM = 1 << 30  # bytes of address space for the interpreter, the libraries and their buffers
COPIES = 2  # of what a file may hold, for which there is address space, too
MORE_MEMORY = "free some memory, or raise its limit (ulimit -v)"
READY = b"ready"  # what a child says when it has begun
MOST_TALK = 64 << 20  # bytes of an answer beside its arrays
ALIGNMENT = 64
LENGTH = struct.Struct("<I")
KINDS = {kind.__name__: kind for kind in (L3Error, RecipeError, InputFileError)}
ONE_THREAD = ONE_BLAS_THREAD | {"OPENIMAGEIO_THREADS": "1"}

F = TypeVar("F", bound=Callable[..., Any])


def isolated(*libraries: str) -> Callable[[F], F]:
    """Make a decoder of foreign files run isolated; `libraries`: those that it imports, which are then imported once.

    The function stands in a module and takes a path, then plain values (text, numbers, None); it returns arrays of numbers,
    plain values, and tuples, lists and dictionaries of these. It may read no other file. What it raises, but for this
    package's errors, becomes an InputFileError that names the file.
    """

    def made(function: F) -> F:
        @functools.wraps(function)
        def decode(path: Path, *plain: Any) -> Any:
            require_regular(path)
            if trusted():
                return _decoded(function, path, *plain)
            with _lock:
                return _the_child().ask(path, function.__module__, function.__qualname__, plain)

        decode.libraries = libraries  # type: ignore[attr-defined]
        return decode  # type: ignore[return-value]

    return made


def start() -> None:
    """Start the child while there is other work, for a caller who knows that it will be needed."""
    if not trusted():
        with _lock:
            _the_child()


def _decoded(function: Callable[..., Any], path: Path, *plain: Any) -> Any:
    """Return function(path, *plain); what the libraries of others raise becomes an InputFileError."""
    try:
        return function(path, *plain)
    except L3Error:
        raise
    except MemoryError as error:
        raise InputFileError(too_much(path)) from error
    except ImportError as error:
        raise L3Error(f"a library that decodes {path} cannot be loaded ({error}); {MORE_MEMORY}") from error
    except Exception as error:  # decoders raise whatever they stumble over
        if isinstance(error, OSError) and error.strerror:
            raise InputFileError(f"{path}: {error.strerror}") from error
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise InputFileError(f"{path} cannot be decoded ({reason}); it is damaged or of another kind") from error


def too_much(path: Path) -> str:
    return (
        f"{path} needs more memory to decode than the {most_bytes() / 1e9:.3g} GB of content that a file may have; "
        f"if it is whole, raise {MEGAPIXELS}, or add ‹trust›"
    )


class _Child:
    """The process that decodes, by its workers, and the socket to it."""

    def __init__(self, limits: tuple[float, int]) -> None:
        self.limits = limits
        self.owner = os.getpid()
        self._arrays = os.memfd_create("l3-arrays")
        self._socket, there = socket.socketpair()
        inherited = (there.fileno(), self._arrays)
        serving = f"serve({inherited[0]}, {inherited[1]}, {limits[0]!r}, {limits[1]})"
        program = f"import sys; sys.path[:] = {sys.path!r}; from l3cli.io.decoder_process import serve; {serving}"
        with there:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", program],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,  # decoders chatter there
                pass_fds=inherited,
                env=os.environ | ONE_THREAD | {"MALLOC_ARENA_MAX": "2", TRUST: "1"},
                process_group=0,  # Ctrl-C is for this process, which then ends its child
            )
        self._open, self._ready = True, False

    @property
    def usable(self) -> bool:
        return self._open and self.owner == os.getpid() and self._process.poll() is None

    def end(self) -> None:
        """Kill it, whatever it does."""
        if not self._open:
            return
        self._open = False
        if self.owner == os.getpid():
            if self._process.poll() is None:
                os.killpg(self._process.pid, signal.SIGKILL)  # and its workers
            self._process.wait()
        self._socket.close()
        os.close(self._arrays)

    def ask(self, path: Path, module: str, name: str, plain: tuple[Any, ...]) -> Any:
        """Return the result of the function `name` of `module` for the file."""
        try:
            self._await_beginning()
            request = [os.getcwd(), stamp(path), module, name, str(path), *plain]
            send(self._socket, json.dumps(request).encode())
            answer = json.loads(receive(self._socket, time.monotonic() + PATIENCE * self.limits[0]))
            result = arrays_back(answer, self._arrays)
            os.ftruncate(self._arrays, 0)
            if "error" in result:
                raise KINDS[result["error"]](result["message"])
            return result["value"]
        except L3Error:
            raise
        except BaseException as error:
            self.end()  # what it would say next belongs to this file
            if isinstance(error, TimeoutError):
                raise InputFileError(self._too_long(path)) from error
            if isinstance(error, EOFError | ConnectionError):
                raise InputFileError(self._epitaph(path)) from error
            if isinstance(error, ValueError | TypeError | KeyError | RecursionError):
                raise InputFileError(f"{path}: the decoder returned an invalid reply; the file may be damaged") from error
            raise

    def _await_beginning(self) -> None:
        """Raise L3Error if the process ends before it has asked for work: no file is to blame."""
        if self._ready:
            return
        try:
            self._ready = receive(self._socket, time.monotonic() + PATIENCE * self.limits[0]) == READY
        except (EOFError, ConnectionError) as error:
            self.end()
            raise L3Error(f"the process that decodes files cannot be started; {MORE_MEMORY}, or add ‹trust›") from error

    def _too_long(self, path: Path) -> str:
        return (
            f"{path} takes longer than {self.limits[0]:g} s to decode; it is damaged, or else raise {SECONDS} or add ‹trust›"
        )

    def _epitaph(self, path: Path) -> str:
        code = self._process.returncode
        if code == -signal.SIGXCPU:
            return self._too_long(path)
        if code == -signal.SIGKILL:
            return too_much(path)
        ended = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return f"{path} makes its decoder crash ({ended}); it is damaged"


_child: _Child | None = None
_lock = ThreadLock()  # one file at a time


def _the_child() -> _Child:
    """Return the child of this process, a new one where there is none that lives and has the limits wanted now."""
    global _child
    wanted = decode_seconds(), ROOM + COPIES * most_bytes()
    if _child is None or not _child.usable or _child.limits != wanted:
        _end_child()
        _child = _Child(wanted)
    return _child


@atexit.register
def _end_child() -> None:
    if _child is not None:
        _child.end()


# ----------------------------------------------------------------------------------------------------------------- messages


def arrays_back(answer: Any, file: int) -> Any:
    """Return an answer with its arrays, copied from `file`. ValueError, TypeError or KeyError if no child gives such."""
    if not isinstance(answer, dict):
        return answer
    if "array" in answer:
        return _array(answer["array"], file)
    if "tuple" in answer:
        return tuple(arrays_back(item, file) for item in answer["tuple"])
    if "list" in answer:
        return [arrays_back(item, file) for item in answer["list"]]
    return {str(key): arrays_back(value, file) for key, value in answer["dict"].items()}


def _array(description: list[Any], file: int) -> np.ndarray:
    """Return the array that an answer describes."""
    kind, shape, order, offset = description
    dtype = np.dtype(kind)
    if dtype.kind not in "biuf" or order not in ("C", "F") or any(type(n) is not int or n < 0 for n in (*shape, offset)):
        raise ValueError("no array of numbers")
    length = prod(shape) * dtype.itemsize
    if offset + length > os.fstat(file).st_size:
        raise ValueError("an array outside its file")
    content = np.empty(length, np.uint8)
    rest = content.data
    while len(rest):
        got = os.preadv(file, [rest], offset)
        if not got:
            raise ValueError("an array that has been cut")
        rest, offset = rest[got:], offset + got
    return content.view(dtype).reshape(shape, order=order)


class ArrayWriter:
    """Writer of arrays to a file, from its beginning."""

    def __init__(self, file: int) -> None:
        self._file, self._end = file, 0

    def append(self, array: np.ndarray) -> dict[str, Any]:
        order = "F" if array.flags.f_contiguous and not array.flags.c_contiguous else "C"
        flat = np.ascontiguousarray(array.T if order == "F" else array)
        start = offset = self._end
        rest = flat.reshape(-1).view(np.uint8).data
        while len(rest):
            done = os.pwrite(self._file, rest, offset)
            rest, offset = rest[done:], offset + done
        self._end = -(-offset // ALIGNMENT) * ALIGNMENT
        return {"array": [array.dtype.str, array.shape, order, start]}


def plain_of(value: Any, writer: ArrayWriter) -> Any:
    """Return a value as JSON can hold it, its arrays given to `writer`."""
    if isinstance(value, np.ndarray):
        return writer.append(value)
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, dict):
        return {"dict": {str(key): plain_of(item, writer) for key, item in value.items()}}
    if isinstance(value, tuple | list):
        return {"tuple" if isinstance(value, tuple) else "list": [plain_of(item, writer) for item in value]}
    if value is None or isinstance(value, str | bool | int | float):
        return value
    raise TypeError(f"{type(value).__name__} cannot be handed over")


def send(connection: socket.socket, text: bytes) -> None:
    connection.sendall(LENGTH.pack(len(text)) + text)


def receive(connection: socket.socket, until: float | None = None) -> bytes:
    """Return a message; TimeoutError if it is not whole at the time `until` of time.monotonic()."""
    (length,) = LENGTH.unpack(_exactly(connection, LENGTH.size, until))
    if length > MOST_TALK:
        raise ValueError("an endless message")
    return _exactly(connection, length, until)


def _exactly(connection: socket.socket, length: int, until: float | None) -> bytes:
    content = bytearray()
    while len(content) < length:
        connection.settimeout(None if until is None else max(until - time.monotonic(), 1e-3))
        got = connection.recv(min(length - len(content), 1 << 20))
        if not got:
            raise EOFError
        content += got
    return bytes(content)


# ----------------------------------------------------------------------- names of files for libraries that take UTF-8 alone


_links: dict[Path, str] = {}  # by absolute path: those of `linked`


@contextlib.contextmanager
def named_in_utf8(path: Path) -> Iterator[str]:
    """Yield a name of the file: as given, or that of a link where it has bytes that are no UTF-8."""
    with linked(path):
        yield _links.get(path.absolute(), str(path))


@contextlib.contextmanager
def linked(path: Path) -> Iterator[None]:
    """Give a file whose name is no UTF-8, within the block and in processes forked there, the link that `named_in_utf8`
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
