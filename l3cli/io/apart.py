"""Foreign files are decoded apart, in a child process of limited time and memory: what the decoders of others stumble over
can end that process, never this one.

A child is started when the first file is read and decodes one after the other; when it has died the next file gets a new
one. Requests and answers are JSON; arrays come through a file in memory, checked against its size and copied, so that
nothing that a child says is executed or believed here. Who trusts his files (`--trust`, or L3_TRUST=1) has them
decoded in his own process.
"""

import atexit
import functools
import importlib
import json
import os
import resource
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from math import prod
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.files import require_regular
from l3cli.limits import MEGAPIXELS, ONE_BLAS_THREAD, TRUST, most_bytes, setting, trusted
from l3cli.quantities import Quantity

SECONDS = "L3_DECODE_SECONDS"  # environment variable: processor time for one file
USUAL_SECONDS = 60.0
PATIENCE = 5  # times the processor time that a file may take by the clock, on a slow disk
ROOM = 1 << 30  # bytes of address space for the interpreter, the libraries and their buffers …
COPIES = 2  # … and so many copies of what a file may hold
MOST_TALK = 64 << 20  # bytes of an answer beside its arrays
ALIGNMENT = 64
READY = b"ready"  # what a child says when it has begun
MORE_MEMORY = "free some memory, or raise its limit (ulimit -v)"
LENGTH = struct.Struct("<I")
KINDS = {kind.__name__: kind for kind in (L3Error, RecipeError, InputFileError)}
ONE_THREAD = ONE_BLAS_THREAD | {"OPENIMAGEIO_THREADS": "1"}

F = TypeVar("F", bound=Callable[..., Any])


def apart(function: F) -> F:
    """Make a decoder of foreign files run apart.

    `function` stands in a module and takes a path, then plain values (text, numbers, None); it returns arrays of numbers,
    plain values, and tuples, lists and dictionaries of these. What it raises, but for errors of this package's own, becomes
    an InputFileError that names the file.
    """

    @functools.wraps(function)
    def decode(path: Path, *plain: Any) -> Any:
        require_regular(path)
        if trusted():
            return _decoded(function, path, *plain)
        with _lock:
            return _the_child().ask(path, function.__module__, function.__qualname__, plain)

    return decode  # type: ignore[return-value]


def start() -> None:
    """Let the child start while there is other work, for a caller who knows that it will be needed."""
    if not trusted():
        with _lock:
            _the_child()


def _decoded(function: Callable[..., Any], path: Path, *plain: Any) -> Any:
    """function(path, *plain); what the libraries of others raise becomes an InputFileError."""
    try:
        return function(path, *plain)
    except L3Error:
        raise
    except MemoryError as error:
        raise InputFileError(_too_much(path)) from error
    except ImportError as error:
        raise L3Error(f"a library that decodes {path} cannot be loaded ({error}); {MORE_MEMORY}") from error
    except OSError as error:
        raise InputFileError(f"{path}: {error.strerror or error}") from error
    except Exception as error:  # decoders raise whatever they stumble over
        reason = f"{type(error).__name__}: {error}"[:200]
        raise InputFileError(f"{path} cannot be decoded ({reason}); it is damaged or of another kind") from error


def _too_much(path: Path) -> str:
    return (
        f"{path} needs more memory to decode than the {most_bytes() / 1e9:.3g} GB of content that a file may have; "
        f"if it is whole, raise {MEGAPIXELS}, or add --trust"
    )


# --------------------------------------------------------------------------------------------------------- parent


class _Child:
    """The process that decodes, and the way to it."""

    def __init__(self, limits: tuple[float, int]) -> None:
        self.limits = limits
        self.owner = os.getpid()
        self._arrays = os.memfd_create("l3-arrays")
        self._socket, there = socket.socketpair()
        inherited = (there.fileno(), self._arrays)
        serving = f"serve({inherited[0]}, {inherited[1]}, {limits[0]!r}, {limits[1]})"
        program = f"import sys; sys.path[:] = {sys.path!r}; from l3cli.io.apart import serve; {serving}"
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
            self._process.kill()
            self._process.wait()
        self._socket.close()
        os.close(self._arrays)

    def ask(self, path: Path, module: str, name: str, plain: tuple[Any, ...]) -> Any:
        """What the function `name` of `module` makes of the file."""
        try:
            self._await_beginning()
            _send(self._socket, json.dumps([os.getcwd(), module, name, str(path), *plain]).encode())
            answer = json.loads(_receive(self._socket, time.monotonic() + PATIENCE * self.limits[0]))
            result = _arrays_back(answer, self._arrays)
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
                raise InputFileError(f"{path} makes its decoder talk nonsense; it is damaged") from error
            raise

    def _await_beginning(self) -> None:
        """L3Error if the process ends before it has asked for work: no file is to blame."""
        if self._ready:
            return
        try:
            self._ready = _receive(self._socket, time.monotonic() + PATIENCE * self.limits[0]) == READY
        except (EOFError, ConnectionError) as error:
            self.end()
            raise L3Error(f"the process that decodes files cannot be started; {MORE_MEMORY}, or add --trust") from error

    def _too_long(self, path: Path) -> str:
        return (
            f"{path} takes longer than {self.limits[0]:g} s to decode; it is damaged, or else raise {SECONDS} or add --trust"
        )

    def _epitaph(self, path: Path) -> str:
        code = self._process.returncode
        if code == -signal.SIGXCPU:
            return self._too_long(path)
        if code == -signal.SIGKILL:
            return _too_much(path)
        ended = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return f"{path} makes its decoder crash ({ended}); it is damaged"


_child: _Child | None = None
_lock = threading.Lock()  # one file at a time


def _the_child() -> _Child:
    """The child of this process, a new one where there is none that lives and has the limits wanted now."""
    global _child
    wanted = _seconds(), ROOM + COPIES * most_bytes()
    if _child is None or not _child.usable or _child.limits != wanted:
        _end_child()
        _child = _Child(wanted)
    return _child


@atexit.register
def _end_child() -> None:
    if _child is not None:
        _child.end()


def _seconds() -> float:
    return setting(SECONDS, Quantity(0.1, 1e6, "s"), USUAL_SECONDS)


def _arrays_back(answer: Any, file: int) -> Any:
    """An answer with its arrays, copied from `file`. ValueError, TypeError or KeyError if it is none that a child gives."""
    if not isinstance(answer, dict):
        return answer
    if "array" in answer:
        return _array(answer["array"], file)
    if "tuple" in answer:
        return tuple(_arrays_back(item, file) for item in answer["tuple"])
    if "list" in answer:
        return [_arrays_back(item, file) for item in answer["list"]]
    return {str(key): _arrays_back(value, file) for key, value in answer["dict"].items()}


def _array(told: list[Any], file: int) -> np.ndarray:
    """The array that an answer describes."""
    kind, shape, order, offset = told
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


# ---------------------------------------------------------------------------------------------------------- child


def serve(talk: int, arrays: int, seconds: float, room: int) -> None:
    """Decode what is asked for until nobody asks any more."""
    for what, most in ((resource.RLIMIT_CORE, 0), (resource.RLIMIT_AS, room), (resource.RLIMIT_FSIZE, room)):
        _limit(what, most)
    with socket.socket(fileno=talk) as connection:
        _send(connection, READY)
        while True:
            try:
                folder, module, name, path, *plain = json.loads(_receive(connection))
            except EOFError:
                return
            os.chdir(folder)  # where the parent is, which may change
            used = resource.getrusage(resource.RUSAGE_SELF)
            _limit(resource.RLIMIT_CPU, int(used.ru_utime + used.ru_stime + seconds) + 1)
            _send(connection, _answer(module, name, Path(path), plain, arrays))


def _limit(what: int, most: int) -> None:
    """Set a limit of this process as far as it is not lower already."""
    hard = resource.getrlimit(what)[1]
    resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _answer(module: str, name: str, path: Path, plain: list[Any], arrays: int) -> bytes:
    try:
        value = getattr(importlib.import_module(module), name)(path, *plain)
        text = json.dumps(_plainly({"value": value}, _Writer(arrays))).encode()
        if len(text) <= MOST_TALK:
            return text
        problem: tuple[str, str] = "InputFileError", f"{path} holds too many parts; it is damaged"
    except L3Error as error:
        problem = type(error).__name__, str(error)
    except MemoryError:
        problem = "InputFileError", _too_much(path)
    except OSError as error:  # of the arrays' file: what a decoder raises has become an InputFileError
        problem = "InputFileError", f"{path}: its content cannot be handed over ({error.strerror})"
    return json.dumps({"dict": dict(zip(("error", "message"), problem, strict=True))}).encode()


class _Writer:
    """Appends arrays to a file from its beginning."""

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


def _plainly(value: Any, writer: _Writer) -> Any:
    """A value as JSON can hold it, its arrays given to `writer`."""
    if isinstance(value, np.ndarray):
        return writer.append(value)
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, dict):
        return {"dict": {str(key): _plainly(item, writer) for key, item in value.items()}}
    if isinstance(value, tuple | list):
        return {"tuple" if isinstance(value, tuple) else "list": [_plainly(item, writer) for item in value]}
    if value is None or isinstance(value, str | bool | int | float):
        return value
    raise TypeError(f"{type(value).__name__} cannot be handed over")


# ----------------------------------------------------------------------------------------------------------- both


def _send(connection: socket.socket, text: bytes) -> None:
    connection.sendall(LENGTH.pack(len(text)) + text)


def _receive(connection: socket.socket, until: float | None = None) -> bytes:
    """A message; TimeoutError if it is not whole at the time `until` of time.monotonic()."""
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
