"""The process that decodes foreign files (isolated.py): its limits, its workers, and the answers they give."""

import contextlib
import importlib
import json
import os
import resource
import signal
import socket
from pathlib import Path
from typing import Any

from l3cli.errors import InputFileError, L3Error
from l3cli.io.confinement import confine
from l3cli.io.isolated import MORE_MEMORY, MOST_TALK, READY, ArrayWriter, isolated, linked, plain_of, receive, send, too_much

MOST_WORKERS = 8  # that live at a time: files may be read in turn, frame by frame

_measures: tuple[str, ...] = ()  # by which this process is confined


@isolated()
def measures(path: Path) -> tuple[str, ...]:
    """Return the names of what confines the worker for a file: of confinement.LANDLOCK and SECCOMP those that hold here."""
    return _measures


def serve(talk: int, arrays: int, seconds: float, room: int) -> None:
    """Have files decoded, each by a worker of its own, until nobody asks any more."""
    for what, most in ((resource.RLIMIT_CORE, 0), (resource.RLIMIT_AS, room), (resource.RLIMIT_FSIZE, room)):
        resource.setrlimit(what, 2 * (_allowed(what, most),))  # the hard limit, too: none of them is lifted again
    workers: dict[str, _Worker] = {}  # by file and decoder, the one that was asked last at the end
    with socket.socket(fileno=talk) as connection:
        send(connection, READY)
        while True:
            try:
                request = receive(connection)
            except EOFError:
                return
            folder, state, module, name, path, *_ = json.loads(request)
            known = json.dumps([folder, state, module, name, path])
            if known not in workers:
                _import(module, name)
                try:
                    others = [connection, *(worker.socket for worker in workers.values())]
                    workers[known] = _Worker(Path(folder, path), arrays, seconds, others)
                except OSError:
                    problem = L3Error(f"no process to decode {path} can be started; {MORE_MEMORY}, or add ‹trust›")
                    send(connection, _problem(problem))
                    continue
            workers[known] = worker = workers.pop(known)
            send(connection, worker.answer(request))
            if len(workers) > MOST_WORKERS:
                workers.pop(next(iter(workers))).end()


def _import(module: str, name: str) -> None:
    """Import a decoder and its libraries: once for all workers, which then read no other file of the caller's."""
    with contextlib.suppress(Exception):  # the worker tries again, and says what is wrong
        for library in getattr(importlib.import_module(module), name).libraries:
            importlib.import_module(library)


class _Worker:
    """A process that decodes one file, confined to it."""

    def __init__(self, path: Path, arrays: int, seconds: float, others: list[socket.socket]) -> None:
        """Fork it, without the sockets to `others`. OSError if there can be no further process."""
        self._owned = contextlib.ExitStack()
        with contextlib.ExitStack() as failed:
            failed.push(self._owned)
            self._owned.enter_context(linked(path))
            ours, theirs = socket.socketpair()
            self.socket = self._owned.enter_context(ours)
            with theirs:
                self._process = os.fork()
                if not self._process:
                    try:
                        for other in (ours, *others):
                            other.close()
                        _decode(theirs, path, arrays, seconds)
                    finally:
                        os._exit(1)
            failed.pop_all()

    def answer(self, request: bytes) -> bytes:
        """Return its answer; where it dies instead, die as it did: its caller then knows."""
        try:
            send(self.socket, request)
            return receive(self.socket)
        except (EOFError, ConnectionError):
            self._owned.close()
            code = os.waitstatus_to_exitcode(os.waitpid(self._process, 0)[1])
            if code < 0:
                with contextlib.suppress(OSError):  # SIGKILL has no handler
                    signal.signal(-code, signal.SIG_DFL)
                os.kill(os.getpid(), -code)
            os._exit(code)

    def end(self) -> None:
        """Kill it, whatever it does."""
        os.kill(self._process, signal.SIGKILL)
        os.waitpid(self._process, 0)
        self._owned.close()


def _decode(connection: socket.socket, path: Path, arrays: int, seconds: float) -> None:
    """Answer requests for a file, confined to it, until nobody asks any more; then end the process."""
    global _measures
    _measures = confine([path])
    while True:
        try:
            folder, _, module, name, path_there, *plain = json.loads(receive(connection))
        except EOFError:
            os._exit(0)
        os.chdir(folder)  # where the caller is: names in messages are those that he gave
        used = resource.getrusage(resource.RUSAGE_SELF)
        until = _allowed(resource.RLIMIT_CPU, int(used.ru_utime + used.ru_stime + seconds) + 1)
        resource.setrlimit(resource.RLIMIT_CPU, (until, resource.getrlimit(resource.RLIMIT_CPU)[1]))
        send(connection, _answer(module, name, Path(path_there), plain, arrays))


def _allowed(what: int, most: int) -> int:
    """Return a limit of this process: `most`, or the hard limit where that is lower."""
    hard = resource.getrlimit(what)[1]
    return most if hard == resource.RLIM_INFINITY else min(most, hard)


def _answer(module: str, name: str, path: Path, plain: list[Any], arrays: int) -> bytes:
    try:
        value = getattr(importlib.import_module(module), name)(path, *plain)
        text = json.dumps(plain_of({"value": value}, ArrayWriter(arrays))).encode()
        if len(text) <= MOST_TALK:
            return text
        return _problem(InputFileError(f"{path} holds too many parts; it is damaged"))
    except L3Error as error:
        return _problem(error)
    except MemoryError:
        return _problem(InputFileError(too_much(path)))
    except OSError as error:  # of the arrays' file: what a decoder raises has become an InputFileError
        return _problem(InputFileError(f"{path}: its content cannot be handed over ({error.strerror})"))


def _problem(error: L3Error) -> bytes:
    return json.dumps({"dict": {"error": type(error).__name__, "message": str(error)}}).encode()
