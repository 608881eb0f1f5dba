"""The process that decodes foreign files (isolated.py): its limits, its workers, and the answers they give.

A worker is confined by Linux's Landlock (files) and seccomp (all else). It may read the files it is given, the installation
of Python and the system's libraries. It writes to no file, opens no socket, starts no process, touches no other one; what it
has open already it may use. Where the kernel lacks one of the two, the other still holds (man 7 landlock, man 2 seccomp).
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
CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446  # syscalls of Landlock, on every architecture
PATH_BENEATH = 1
VERSION = 1  # flag of CREATE_RULESET that asks for Landlock's own
RIGHTS, ADDED_IN = 13, (2, 3, 5)  # number of rights of access in its first version; versions that added another
READ_FILE, READ_FOLDER = 1 << 2, 1 << 3
SYSTEM = ("/usr", "/lib", "/lib64", "/etc/ld.so.cache", "/etc/localtime")
PACKAGES = ("site-packages", "dist-packages")

# Syscalls that reach beyond the process, by number on x86_64 and on aarch64 (None: it has none of the name).
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
X32 = 0x40000000  # x86_64: syscalls from here on are those of another ABI
LOAD, EQUAL, AT_LEAST, HAS_BITS, RETURN = 0x20, 0x15, 0x35, 0x45, 0x06  # instructions of classic BPF
ALLOW, REFUSE = 0x7FFF0000, 0x00050000  # what a filter returns; the second with an error's number
NUMBER_AT, ARCHITECTURE_AT, ARGUMENT_AT = 0, 4, 16  # in struct seccomp_data, of the first argument the low half
MOST_WORKERS = 8  # that live at a time: files may be read in turn, frame by frame

_measures: tuple[str, ...] = ()  # by which this process is confined


def confine(files: Iterable[Path]) -> tuple[str, ...]:
    """Confine this process, which has one thread, to reading `files`; return what of Landlock and seccomp holds now.

    It cannot be undone.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(NO_NEW_PRIVILEGES, *map(ctypes.c_ulong, (1, 0, 0, 0))):
        return ()
    measures = {LANDLOCK: _restrict_files(libc, [*files, *_installation()]), SECCOMP: _filter_syscalls(libc)}
    return tuple(name for name, holds in measures.items() if holds)


def _installation() -> set[Path]:
    """Return the folders that Python and its libraries read while they run."""
    package = Path(__file__).parents[1]
    packages = [path for path in sys.path if Path(path).name in PACKAGES]
    return {package, *map(Path, (sys.prefix, sys.base_prefix, sys.exec_prefix, *packages, *SYSTEM))}


def _restrict_files(libc: ctypes.CDLL, readable: Iterable[Path]) -> bool:
    """Refuse all access to files but reading what lies in `readable`; False where the kernel cannot."""
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
                continue  # it is not there
            rights = READ_FILE | READ_FOLDER if path.is_dir() else READ_FILE
            rule = ctypes.create_string_buffer(struct.pack("=Qi", rights, place), 12)
            libc.syscall(ADD_RULE, ruleset, PATH_BENEATH, rule, 0)
            os.close(place)
        return bool(libc.syscall(RESTRICT_SELF, ruleset, 0) == 0)
    finally:
        os.close(ruleset)


def _filter_syscalls(libc: ctypes.CDLL) -> bool:
    """Refuse syscalls that reach beyond the process; False where the kernel or this module cannot."""
    machine = platform.machine()
    if machine not in ARCHITECTURES or sys.maxsize < 2**32:
        return False
    program = _program(machine)
    code = ctypes.create_string_buffer(program, len(program))
    described = ctypes.create_string_buffer(struct.pack("@HP", len(program) // 8, ctypes.addressof(code)))
    return bool(libc.prctl(SET_SECCOMP, *map(ctypes.c_ulong, (FILTER, ctypes.addressof(described), 0, 0))) == 0)


def _program(machine: str) -> bytes:
    """Return the filter as classic BPF, eight bytes an instruction."""
    column = list(ARCHITECTURES).index(machine)
    numbers = [each[column] for each in REFUSED.values()] + ([] if column else [*OLD_NAMES.values()])
    refuse, absent = REFUSE | errno.EPERM, REFUSE | errno.ENOSYS
    code = [(LOAD, 0, 0, ARCHITECTURE_AT), (EQUAL, 1, 0, ARCHITECTURES[machine]), (RETURN, 0, 0, refuse)]
    code += [(LOAD, 0, 0, NUMBER_AT)]
    code += [] if column else [(AT_LEAST, 0, 1, X32), (RETURN, 0, 0, refuse)]
    for number in numbers:
        if number is not None:
            code += [(EQUAL, 0, 1, number), (RETURN, 0, 0, refuse)]
    # The C library tries `clone3`, whose flags a filter cannot read, and takes `clone` where there is none.
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
    """Return the names of what confines the worker for a file: LANDLOCK and SECCOMP, where they hold."""
    return _measures


def serve(talk: int, arrays: int, seconds: float, room: int) -> None:
    """Decode files, each by a worker of its own, until nobody asks any more."""
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
