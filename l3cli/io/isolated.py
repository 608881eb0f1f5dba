"""Decode untrusted files in an isolated process with limited time and memory.

A crash in a third-party decoder ends only the isolated process. This process starts when the first file is read, and forks a
worker process for each file (decoder_process.py). If the kernel supports Landlock, a worker can read only its own file. If a
worker dies, the isolated process ends too, and l3 starts a new one for the next file.

Requests and replies are JSON. Arrays are passed through a memory file, and are copied after their sizes have been checked.
Data from a worker are never executed. With `--trust` or L3_TRUST=1, files are decoded in the current process instead.
"""

import atexit
import functools
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from math import prod
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import numpy as np

from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.system.files import require_regular, stamp
from l3cli.system.limits import MEGAPIXELS, ONE_BLAS_THREAD, SECONDS, TRUST, decode_seconds, most_bytes, trusted
from l3cli.system.locks import ThreadLock

WALL_PER_CPU_TIME = 5  # ratio of the wall-clock limit to the CPU time limit, because disks may be slow
PROGRAM_BYTES = 1 << 30  # address space for the interpreter, the libraries and their buffers, in bytes
COPIES = 2  # additional address space, as a multiple of the maximum size of the decoded content
MORE_MEMORY = "free some memory, or raise the memory limit of the shell (ulimit -v)"
READY = b"ready"  # first message of the isolated process
MAX_REPLY = 64 << 20  # maximum size of a reply without its arrays, in bytes
LENGTH = struct.Struct("<I")
KINDS = {kind.__name__: kind for kind in (L3Error, RecipeError, InputFileError)}
ONE_THREAD = ONE_BLAS_THREAD | {"OPENIMAGEIO_THREADS": "1"}

F = TypeVar("F", bound=Callable[..., Any])


def isolated(*libraries: str) -> Callable[[F], F]:
    """Return a decorator that runs a decoder of untrusted files in the isolated process.

    Parameters
    ----------
    libraries : str
        Modules that the decoder imports. The isolated process imports them once, before it forks workers.

    Returns
    -------
    callable
        The decorator.

    Notes
    -----
    The decoder must be a function at module level. Its first parameter is the path of the only file that it may read. Its
    other parameters are text, numbers or None. It returns numeric arrays, text, numbers or None, or tuples, lists and
    dictionaries of such values. Exceptions other than L3Error are converted to an InputFileError that names the file.
    """

    def made(function: F) -> F:
        @functools.wraps(function)
        def decode(path: Path, *plain: Any) -> Any:
            require_regular(path)
            _require_utf8(path)
            if trusted():
                return _decoded(function, path, *plain)
            with _lock:
                return _the_child().ask(path, function.__module__, function.__qualname__, plain)

        decode.libraries = libraries  # type: ignore[attr-defined]
        return decode  # type: ignore[return-value]

    return made


def start() -> None:
    """Start the isolated process in advance, unless files are trusted."""
    if not trusted():
        with _lock:
            _the_child()


def _require_utf8(path: Path) -> None:
    """Raise InputFileError if a path is not UTF-8, because libraries cannot open such files."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise InputFileError(f"{path}: the name of the file or of a folder is not UTF-8; rename it") from None


def _decoded(function: Callable[..., Any], path: Path, *plain: Any) -> Any:
    """Call a decoder in this process. An ImportError becomes an L3Error, and other exceptions become InputFileErrors."""
    try:
        return function(path, *plain)
    except L3Error:
        raise
    except MemoryError as error:
        raise InputFileError(too_much(path)) from error
    except ImportError as error:
        raise L3Error(f"the library that decodes {path} cannot be loaded ({error}); {MORE_MEMORY}") from error
    except Exception as error:  # decoders raise exceptions of many types
        if isinstance(error, OSError) and error.strerror:
            raise InputFileError(f"{path}: {error.strerror}") from error
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise InputFileError(
            f"{path} cannot be decoded ({reason}) and may be damaged; copy the file again, or use another format"
        ) from error


def too_much(path: Path) -> str:
    return (
        f"{path} needs more memory to decode than the limit of {most_bytes() / 1e9:.3g} GB; "
        f"if the file is intact, increase the environment variable {MEGAPIXELS} or add ‹trust›"
    )


class _Child:
    """The isolated process, with a socket for requests and replies."""

    def __init__(self, limits: tuple[float, int]) -> None:
        self.limits = limits
        self.owner = os.getpid()
        self._arrays = open(os.memfd_create("l3-arrays"), "r+b", buffering=0)  # noqa: SIM115  closed by `end`
        self._socket, there = socket.socketpair()
        inherited = (there.fileno(), self._arrays.fileno())
        serving = f"serve({inherited[0]}, {inherited[1]}, {limits[0]!r}, {limits[1]})"
        program = f"import sys; sys.path[:] = {sys.path!r}; from l3cli.io.decoder_process import serve; {serving}"
        with there:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", program],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,  # decoders print messages to stderr
                pass_fds=inherited,
                env=os.environ | ONE_THREAD | {"MALLOC_ARENA_MAX": "2", TRUST: "1"},
                process_group=0,  # so that Ctrl-C interrupts only this process, which then ends the isolated process
            )
        self._open, self._ready = True, False

    @property
    def usable(self) -> bool:
        """Whether the isolated process is running, and was started by this process rather than by a parent process."""
        return self._open and self.owner == os.getpid() and self._process.poll() is None

    def end(self) -> None:
        """Kill the isolated process and its workers immediately."""
        if not self._open:
            return
        self._open = False
        if self.owner == os.getpid():
            if self._process.poll() is None:
                os.killpg(self._process.pid, signal.SIGKILL)  # the process group includes the workers
            self._process.wait()
        self._socket.close()
        self._arrays.close()

    def ask(self, path: Path, module: str, name: str, plain: tuple[Any, ...]) -> Any:
        """Call a decoder (`module`, `name`) in the isolated process, and return its result or raise its error.

        If the isolated process takes too long, crashes or returns an invalid reply, it is killed, and InputFileError is
        raised.
        """
        try:
            self._wait_until_ready()
            request = [os.getcwd(), stamp(path), module, name, str(path), *plain]
            send(self._socket, json.dumps(request).encode())
            answer = json.loads(receive(self._socket, time.monotonic() + WALL_PER_CPU_TIME * self.limits[0]))
            result = arrays_back(answer, self._arrays)
            self._arrays.truncate(0)
            if "error" in result:
                raise KINDS[result["error"]](result["message"])
            return result["value"]
        except L3Error:
            raise
        except BaseException as error:
            self.end()  # otherwise, a late reply could be mistaken for the reply to the next request
            if isinstance(error, TimeoutError):
                raise InputFileError(self._timeout_message(path)) from error
            if isinstance(error, EOFError | ConnectionError):
                raise InputFileError(self._crash_message(path)) from error
            if isinstance(error, ValueError | TypeError | KeyError | RecursionError):
                raise InputFileError(
                    f"{path}: the decoder returned an invalid reply, so the file may be damaged; copy the file again"
                ) from error
            raise

    def _wait_until_ready(self) -> None:
        """Wait until the isolated process is ready. Raises L3Error if it ends before that."""
        if self._ready:
            return
        try:
            self._ready = receive(self._socket, time.monotonic() + WALL_PER_CPU_TIME * self.limits[0]) == READY
        except (EOFError, ConnectionError) as error:
            self.end()
            raise L3Error(f"the process that decodes files cannot start; {MORE_MEMORY}, or add ‹trust›") from error

    def _timeout_message(self, path: Path) -> str:
        return (
            f"{path} takes longer than {self.limits[0]:g} s to decode and may be damaged; "
            f"if the file is intact, increase the environment variable {SECONDS} or add ‹trust›"
        )

    def _crash_message(self, path: Path) -> str:
        """Explain a crash of the isolated process to the user, according to its exit code."""
        code = self._process.returncode
        if code == -signal.SIGXCPU:
            return self._timeout_message(path)
        if code == -signal.SIGKILL:
            return too_much(path)
        ended = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return f"{path} crashes its decoder ({ended}) and is probably damaged; copy the file again"


_child: _Child | None = None
_lock = ThreadLock()  # the isolated process handles one request at a time


def _the_child() -> _Child:
    """Return the isolated process. A new one is started if none is running, or if the limits have changed."""
    global _child
    wanted = decode_seconds(), PROGRAM_BYTES + COPIES * most_bytes()
    if _child is None or not _child.usable or _child.limits != wanted:
        _end_child()
        _child = _Child(wanted)
    return _child


@atexit.register
def _end_child() -> None:
    if _child is not None:
        _child.end()


# ----------------------------------------------------------------------------------------------------------------- messages


def arrays_back(answer: Any, file: BinaryIO) -> Any:
    """Convert a reply from JSON types back to values, and copy its arrays from the memory file `file`.

    Raises ValueError, TypeError or KeyError if the reply is invalid.
    """
    if not isinstance(answer, dict):
        return answer
    if "array" in answer:
        return _array(answer["array"], file)
    if "tuple" in answer:
        return tuple(arrays_back(item, file) for item in answer["tuple"])
    if "list" in answer:
        return [arrays_back(item, file) for item in answer["list"]]
    return {str(key): arrays_back(value, file) for key, value in answer["dict"].items()}


def _array(description: list[Any], file: BinaryIO) -> np.ndarray:
    """Copy an array from the memory file. Raises ValueError if its description [dtype, shape, offset] is invalid."""
    kind, shape, offset = description
    dtype = np.dtype(kind)
    if dtype.kind not in "biuf" or any(type(n) is not int or n < 0 for n in (*shape, offset)):
        raise ValueError("the array does not contain numbers")
    if offset + prod(shape) * dtype.itemsize > os.fstat(file.fileno()).st_size:
        raise ValueError("the array extends beyond the end of the memory file")
    file.seek(offset)
    return np.fromfile(file, dtype, prod(shape)).reshape(shape)


def plain_of(value: Any, file: BinaryIO) -> Any:
    """Convert a value to JSON types, and write its arrays to the memory file `file`.

    Raises TypeError if the value's type is not supported.
    """
    if isinstance(value, np.ndarray):
        offset = file.tell()
        np.ascontiguousarray(value).tofile(file)
        return {"array": [value.dtype.str, value.shape, offset]}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, dict):
        return {"dict": {str(key): plain_of(item, file) for key, item in value.items()}}
    if isinstance(value, tuple | list):
        return {"tuple" if isinstance(value, tuple) else "list": [plain_of(item, file) for item in value]}
    if value is None or isinstance(value, str | bool | int | float):
        return value
    raise TypeError(f"a {type(value).__name__} cannot be passed between processes")


def send(connection: socket.socket, text: bytes) -> None:
    """Send a message, preceded by its length."""
    connection.sendall(LENGTH.pack(len(text)) + text)


def receive(connection: socket.socket, until: float | None = None) -> bytes:
    """Receive a message that was sent with `send`.

    Parameters
    ----------
    connection : socket
        The connection.
    until : float, optional
        Deadline, as a value of time.monotonic(). [default: no limit]

    Raises
    ------
    TimeoutError
        If the message is incomplete at the deadline.
    EOFError
        If the connection is closed before the message is complete.
    ValueError
        If the message is longer than MAX_REPLY.
    """
    (length,) = LENGTH.unpack(_exactly(connection, LENGTH.size, until))
    if length > MAX_REPLY:
        raise ValueError("the message exceeds the maximum size")
    return _exactly(connection, length, until)


def _exactly(connection: socket.socket, length: int, until: float | None) -> bytes:
    """Receive exactly `length` bytes. Raises the same errors as `receive`."""
    content = bytearray()
    while len(content) < length:
        connection.settimeout(None if until is None else max(until - time.monotonic(), 1e-3))
        got = connection.recv(min(length - len(content), 1 << 20))
        if not got:
            raise EOFError
        content += got
    return bytes(content)
