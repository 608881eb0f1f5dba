"""Messages between the decoder process and the one that asks: JSON over a socket, arrays through a file in memory,
checked against its size and copied, so that nothing in a message is executed or believed."""

import os
import socket
import struct
import time
from math import prod
from typing import Any

import numpy as np

READY = b"ready"  # what a child says when it has begun
MOST_TALK = 64 << 20  # bytes of an answer beside its arrays
ALIGNMENT = 64
LENGTH = struct.Struct("<I")


def arrays_back(answer: Any, file: int) -> Any:
    """Return an answer with its arrays, copied from `file`. ValueError, TypeError or KeyError if it is none that a child
    gives."""
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
