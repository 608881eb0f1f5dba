"""The process that decodes foreign files for isolated.py: its limits, its workers, and their replies.

A worker is confined by Linux's Landlock (files) and seccomp (everything else). It may read the files that it is given, the
Python installation and the system's libraries. It cannot write to files, open sockets, start processes or touch other
processes. It may use what it already has open. If the kernel lacks one of the two, the other still applies (man 7 landlock,
man 2 seccomp).
"""

import contextlib
import ctypes
import errno
import importlib
import json
import os
import platform
import resource
import signal
import socket
import struct
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from l3cli.errors import InputFileError, L3Error
from l3cli.io.isolated import MORE_MEMORY, MOST_TALK, READY, ArrayWriter, isolated, linked, plain_of, receive, send, too_much

LANDLOCK, SECCOMP = "Landlock", "seccomp"
NO_NEW_PRIVILEGES, SET_SECCOMP, FILTER = 38, 22, 2  # prctl
CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446  # syscalls of Landlock, the same on every architecture
PATH_BENEATH = 1
VERSION = 1  # flag of CREATE_RULESET that asks for Landlock's version
RIGHTS, ADDED_IN = 13, (2, 3, 5)  # number of access rights in the first version; versions that added one more
READ_FILE, READ_FOLDER = 1 << 2, 1 << 3
SYSTEM = ("/usr", "/lib", "/lib64", "/etc/ld.so.cache", "/etc/localtime")
PACKAGES = ("site-packages", "dist-packages")

# Syscalls that reach beyond the process: their numbers on x86_64 (None if it lacks the syscall) and on aarch64.
REFUSED: dict[str, tuple[int | None, int]] = {
    "socket": (41, 198), "connect": (42, 203), "accept": (43, 202), "bind": (49, 200), "listen": (50, 201),
    "socketpair": (53, 199), "accept4": (288, 242), "execve": (59, 221), "execveat": (322, 281), "tkill": (200, 130),
    "rt_sigqueueinfo": (129, 138), "rt_tgsigqueueinfo": (297, 240), "pidfd_send_signal": (424, 424),
    "pidfd_open": (434, 434), "pidfd_getfd": (438, 438), "ptrace": (101, 117), "process_vm_readv": (310, 270),
    "process_vm_writev": (311, 271), "kcmp": (312, 272), "setpgid": (109, 154), "setsid": (112, 157),
    "setpriority": (141, 140), "ioprio_set": (251, 30), "sched_setparam": (142, 118), "sched_setscheduler": (144, 119),
    "sched_setaffinity": (203, 122), "sched_setattr": (314, 274), "truncate": (76, 45), "fchmod": (91, 52),
    "fchmodat": (268, 53), "fchmodat2": (452, 452), "fchown": (93, 55), "fchownat": (260, 54), "utimensat": (280, 88),
    "setxattr": (188, 5), "lsetxattr": (189, 6), "fsetxattr": (190, 7), "removexattr": (197, 14),
    "lremovexattr": (198, 15), "fremovexattr": (199, 16), "setxattrat": (463, 463), "removexattrat": (466, 466),
    "file_setattr": (469, 469), "shmget": (29, 194), "shmat": (30, 196), "semget": (64, 190), "msgget": (68, 186),
    "mq_open": (240, 180), "mount": (165, 40), "umount2": (166, 39), "unshare": (272, 97), "setns": (308, 268),
    "bpf": (321, 280), "perf_event_open": (298, 241), "add_key": (248, 217), "request_key": (249, 218),
    "keyctl": (250, 219), "userfaultfd": (323, 282), "io_uring_setup": (425, 425), "memfd_create": (319, 279),
    "memfd_secret": (447, 447), "chroot": (161, 51), "reboot": (169, 142), "settimeofday": (164, 170),
    "clock_settime": (227, 112), "sethostname": (170, 161), "setdomainname": (171, 162), "swapon": (167, 224),
    "swapoff": (168, 225), "acct": (163, 89), "init_module": (175, 105), "finit_module": (313, 273),
    "kexec_load": (246, 104), "kexec_file_load": (320, 294), "open_by_handle_at": (304, 265),
}  # fmt: skip
OLD_NAMES = {"fork": 57, "vfork": 58, "chmod": 90, "chown": 92, "lchown": 94, "utime": 132, "utimes": 235, "futimesat": 261}
CLONE, CLONE3, KILL, TGKILL, PRLIMIT = (56, 220), (435, 435), (62, 129), (234, 131), (302, 261)
CLONE_THREAD = 0x10000
ARCHITECTURES = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}  # AUDIT_ARCH_…, in the order of the numbers
X32 = 0x40000000  # on x86_64, syscall numbers from here on belong to the x32 ABI
LOAD, EQUAL, AT_LEAST, HAS_BITS, RETURN = 0x20, 0x15, 0x35, 0x45, 0x06  # instructions of classic BPF
ALLOW, REFUSE = 0x7FFF0000, 0x00050000  # return values of a filter; an error number is added to the second
NUMBER_AT, ARCHITECTURE_AT, ARGUMENT_AT = 0, 4, 16  # offsets in struct seccomp_data; low half of the first argument
MOST_WORKERS = 8  # workers that live at the same time, because several files may be read alternately

_measures: tuple[str, ...] = ()  # names of the measures that confine this process


def confine(files: Iterable[Path]) -> tuple[str, ...]:
    """Confine this process, which must have one thread, to reading `files`. This cannot be undone.

    Returns which of Landlock and seccomp are now in force.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(NO_NEW_PRIVILEGES, *map(ctypes.c_ulong, (1, 0, 0, 0))):
        return ()
    measures = {LANDLOCK: _restrict_files(libc, [*files, *_installation()]), SECCOMP: _filter_syscalls(libc)}
    return tuple(name for name, holds in measures.items() if holds)


def _installation() -> set[Path]:
    """Return the folders that Python and its libraries read at run time."""
    package = Path(__file__).parents[1]
    packages = [path for path in sys.path if Path(path).name in PACKAGES]
    return {package, *map(Path, (sys.prefix, sys.base_prefix, sys.exec_prefix, *packages, *SYSTEM))}


def _restrict_files(libc: ctypes.CDLL, readable: Iterable[Path]) -> bool:
    """Deny all file access except reading below `readable`. Returns False if the kernel cannot do that."""
    version = libc.syscall(CREATE_RULESET, None, ctypes.c_size_t(0), VERSION)
    every_right = (1 << RIGHTS + sum(version >= added for added in ADDED_IN)) - 1
    handled = ctypes.create_string_buffer(struct.pack("=Q", every_right), 8)
    ruleset = libc.syscall(CREATE_RULESET, handled, ctypes.c_size_t(8), 0)
    if ruleset < 0:
        return False
    try:
        for path in readable:
            try:
                place = os.open(path, os.O_PATH | os.O_CLOEXEC)
            except OSError:
                continue  # it does not exist
            rights = READ_FILE | READ_FOLDER if path.is_dir() else READ_FILE
            rule = ctypes.create_string_buffer(struct.pack("=Qi", rights, place), 12)
            libc.syscall(ADD_RULE, ruleset, PATH_BENEATH, rule, 0)
            os.close(place)
        return bool(libc.syscall(RESTRICT_SELF, ruleset, 0) == 0)
    finally:
        os.close(ruleset)


def _filter_syscalls(libc: ctypes.CDLL) -> bool:
    """Deny syscalls that reach beyond the process. Returns False if the kernel or this module cannot do that."""
    machine = platform.machine()
    if machine not in ARCHITECTURES or sys.maxsize < 2**32:
        return False
    program = _program(machine)
    code = ctypes.create_string_buffer(program, len(program))
    described = ctypes.create_string_buffer(struct.pack("@HP", len(program) // 8, ctypes.addressof(code)))
    return bool(libc.prctl(SET_SECCOMP, *map(ctypes.c_ulong, (FILTER, ctypes.addressof(described), 0, 0))) == 0)


def _program(machine: str) -> bytes:
    """Return the filter as classic BPF, eight bytes per instruction."""
    column = list(ARCHITECTURES).index(machine)
    numbers = [each[column] for each in REFUSED.values()] + ([] if column else [*OLD_NAMES.values()])
    refuse, absent = REFUSE | errno.EPERM, REFUSE | errno.ENOSYS
    code = [(LOAD, 0, 0, ARCHITECTURE_AT), (EQUAL, 1, 0, ARCHITECTURES[machine]), (RETURN, 0, 0, refuse)]
    code += [(LOAD, 0, 0, NUMBER_AT)]
    code += [] if column else [(AT_LEAST, 0, 1, X32), (RETURN, 0, 0, refuse)]
    for number in numbers:
        if number is not None:
            code += [(EQUAL, 0, 1, number), (RETURN, 0, 0, refuse)]
    # A filter cannot read the flags of `clone3`. If it does not seem to exist, the C library falls back to `clone`.
    code += [(EQUAL, 0, 1, CLONE3[column]), (RETURN, 0, 0, absent)]
    itself = os.getpid()
    for syscalls, test, value in (
        (CLONE, HAS_BITS, CLONE_THREAD), (KILL, EQUAL, itself), (TGKILL, EQUAL, itself), (PRLIMIT, EQUAL, 0),
    ):  # fmt: skip
        code += [(EQUAL, 0, 4, syscalls[column]), (LOAD, 0, 0, ARGUMENT_AT)]
        code += [(test, 0, 1, value), (RETURN, 0, 0, ALLOW), (RETURN, 0, 0, refuse)]
    code += [(RETURN, 0, 0, ALLOW)]
    return b"".join(struct.pack("=HBBI", *each) for each in code)


@isolated()
def measures(path: Path) -> tuple[str, ...]:
    """Return which of LANDLOCK and SECCOMP confine the worker for a file."""
    return _measures


def serve(talk: int, arrays: int, seconds: float, room: int) -> None:
    """Decode files, each with a worker of its own, until the connection closes.

    Parameters
    ----------
    talk : int
        File descriptor of the socket to the caller.
    arrays : int
        File descriptor of the file through which arrays are returned.
    seconds : float
        CPU time allowed per file.
    room : int
        Address space in bytes.
    """
    for what, most in ((resource.RLIMIT_CORE, 0), (resource.RLIMIT_AS, room), (resource.RLIMIT_FSIZE, room)):
        resource.setrlimit(what, 2 * (_allowed(what, most),))  # hard limits too, so that they cannot be raised again
    workers: dict[str, _Worker] = {}  # by file and decoder, least recently used first
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
    """Import a decoder and its libraries once, before workers are forked and confined."""
    with contextlib.suppress(Exception):  # the worker tries again and reports the error
        for library in getattr(importlib.import_module(module), name).libraries:
            importlib.import_module(library)


class _Worker:
    """A process that decodes one file and can read no other."""

    def __init__(self, path: Path, arrays: int, seconds: float, others: list[socket.socket]) -> None:
        """Fork the worker without the sockets `others`. Raises OSError if no further process can be started."""
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
        """Return the worker's reply. If the worker dies, end this process in the same way, so that the caller notices."""
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
        """Kill the worker process immediately."""
        os.kill(self._process, signal.SIGKILL)
        os.waitpid(self._process, 0)
        self._owned.close()


def _decode(connection: socket.socket, path: Path, arrays: int, seconds: float) -> None:
    """Confine this process, answer requests for a file until the connection closes, then exit."""
    global _measures
    _measures = confine([path])
    while True:
        try:
            folder, _, module, name, path_there, *plain = json.loads(receive(connection))
        except EOFError:
            os._exit(0)
        os.chdir(folder)  # the caller's folder, so that relative names work and appear in messages as given
        used = resource.getrusage(resource.RUSAGE_SELF)
        until = _allowed(resource.RLIMIT_CPU, int(used.ru_utime + used.ru_stime + seconds) + 1)
        resource.setrlimit(resource.RLIMIT_CPU, (until, resource.getrlimit(resource.RLIMIT_CPU)[1]))
        send(connection, _answer(module, name, Path(path_there), plain, arrays))


def _allowed(what: int, most: int) -> int:
    """Return the lower of `most` and the hard limit of this process."""
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
    except OSError as error:  # from the file of the arrays; decoders' errors have become InputFileErrors already
        return _problem(InputFileError(f"{path}: its content cannot be handed over ({error.strerror})"))


def _problem(error: L3Error) -> bytes:
    return json.dumps({"dict": {"error": type(error).__name__, "message": str(error)}}).encode()
