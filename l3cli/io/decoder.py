"""The process that decodes foreign files (apart.py): its limits, and the answers it gives."""

import importlib
import json
import os
import resource
import socket
from pathlib import Path
from typing import Any

from l3cli.errors import L3Error
from l3cli.io.apart import too_much
from l3cli.io.handover import MOST_TALK, READY, ArrayWriter, plain_of, receive, send


def serve(talk: int, arrays: int, seconds: float, room: int) -> None:
    """Decode what is asked for until nobody asks any more."""
    for what, most in ((resource.RLIMIT_CORE, 0), (resource.RLIMIT_AS, room), (resource.RLIMIT_FSIZE, room)):
        _limit(what, most)
    with socket.socket(fileno=talk) as connection:
        send(connection, READY)
        while True:
            try:
                folder, module, name, path, *plain = json.loads(receive(connection))
            except EOFError:
                return
            os.chdir(folder)  # where the parent is, which may change
            used = resource.getrusage(resource.RUSAGE_SELF)
            _limit(resource.RLIMIT_CPU, int(used.ru_utime + used.ru_stime + seconds) + 1)
            send(connection, _answer(module, name, Path(path), plain, arrays))


def _limit(what: int, most: int) -> None:
    """Set a limit of this process as far as it is not lower already."""
    hard = resource.getrlimit(what)[1]
    resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _answer(module: str, name: str, path: Path, plain: list[Any], arrays: int) -> bytes:
    try:
        value = getattr(importlib.import_module(module), name)(path, *plain)
        text = json.dumps(plain_of({"value": value}, ArrayWriter(arrays))).encode()
        if len(text) <= MOST_TALK:
            return text
        problem: tuple[str, str] = "InputFileError", f"{path} holds too many parts; it is damaged"
    except L3Error as error:
        problem = type(error).__name__, str(error)
    except MemoryError:
        problem = "InputFileError", too_much(path)
    except OSError as error:  # of the arrays' file: what a decoder raises has become an InputFileError
        problem = "InputFileError", f"{path}: its content cannot be handed over ({error.strerror})"
    return json.dumps({"dict": dict(zip(("error", "message"), problem, strict=True))}).encode()
