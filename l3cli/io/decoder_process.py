"""The process that decodes untrusted files for isolated.py. It forks a worker with restricted rights for each file.

Three independent measures restrict a worker:

* Resource limits bound its CPU time, its address space and the size of the files that it writes.
* Landlock, a Linux security module (man 7 landlock), restricts file access. A worker can read only its input file, the
  Python installation and the system libraries. It cannot write files or start programs. On newer kernels, it can also
  neither open TCP connections nor send signals to other processes.
* seccomp denies system calls that affect anything outside the process. This measure requires pyseccomp and libseccomp.

If the system does not support one of the measures, the other measures still apply. Files and sockets that are already open
remain usable.
"""

import contextlib
import ctypes
import errno
import importlib
import json
import os
import resource
import signal
import socket
import struct
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from l3cli.errors import InputFileError, L3Error
from l3cli.io.isolated import MAX_REPLY, MORE_MEMORY, READY, isolated, plain_of, receive, send, too_much
from l3cli.system.limits import without_plots

try:
    import pyseccomp
except (ImportError, RuntimeError):  # RuntimeError: libseccomp.so.2 is missing
    pyseccomp = None

ABI, SECCOMP = "Landlock ABI ", "seccomp"  # names of the measures; the Landlock version is appended to the first name
SET_NO_NEW_PRIVILEGES = 38  # prctl option
CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446  # Landlock system calls, with the same numbers on all architectures
ASK_FOR_VERSION = 1  # flag that makes CREATE_RULESET return the Landlock version
PATH_BENEATH = 1  # type of a rule that grants rights for a file, or for everything below a folder
FILE_RIGHTS, ADDED_IN = 13, (2, 3, 5)  # number of file rights in Landlock 1; versions that each added one right
READ_FILE, READ_FOLDER = 1 << 2, 1 << 3
TCP, TCP_SINCE = 0b11, 4  # rights to bind and to connect, and the Landlock version that introduced them
SCOPES, SCOPES_SINCE = 0b11, 6  # restrictions of abstract Unix sockets and signals, and the version that introduced them
SYSTEM = ("/usr", "/lib", "/lib64", "/etc/ld.so.cache", "/etc/localtime")
PACKAGES = ("site-packages", "dist-packages")
MAX_WORKERS = 8  # maximum number of workers that are kept, because a stage may alternate between files

DENIED = {  # what the system calls affect → names of the denied system calls
    "sockets": "socket socketpair connect bind listen accept accept4",
    "programs": "execve execveat",
    "processes": "fork vfork setpgid setsid",
    "signals": "tkill rt_sigqueueinfo rt_tgsigqueueinfo pidfd_open pidfd_getfd pidfd_send_signal",
    "memory of processes": "ptrace process_vm_readv process_vm_writev kcmp perf_event_open bpf userfaultfd io_uring_setup",
    "priority": "setpriority ioprio_set sched_setparam sched_setscheduler sched_setaffinity sched_setattr",
    "permissions": "chmod fchmod fchmodat fchmodat2 chown fchown lchown fchownat",
    "times and sizes": "utime utimes futimesat utimensat truncate",
    "attributes": "setxattr lsetxattr fsetxattr removexattr lremovexattr fremovexattr setxattrat removexattrat file_setattr",
    "shared memory": "shmget shmat semget msgget mq_open memfd_create memfd_secret",
    "keys and handles": "add_key request_key keyctl open_by_handle_at",
    "the system": "chroot mount umount2 unshare setns reboot settimeofday clock_settime sethostname setdomainname "
    "swapon swapoff acct init_module finit_module kexec_load kexec_file_load",
}
CLONE_THREAD = 0x10000  # flag of the clone system call

_measures: tuple[str, ...] = ()  # measures that are active in this worker, in addition to resource limits


def confine(files: Iterable[Path]) -> tuple[str, ...]:
    """Permanently restrict this process, which must have a single thread, to reading `files` and the Python installation.

    Returns the names of the measures that the system supports, such as ("Landlock ABI 7", "seccomp").
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(SET_NO_NEW_PRIVILEGES, *map(ctypes.c_ulong, (1, 0, 0, 0))):
        return ()
    version = _restrict_files(libc, [*files, *_installation()])
    return (*([f"{ABI}{version}"] if version else []), *([SECCOMP] if _filter_system_calls() else []))


def _installation() -> set[Path]:
    """Return the folders and files from which Python and its libraries load code and data at run time."""
    package = Path(__file__).parents[1]
    packages = [path for path in sys.path if Path(path).name in PACKAGES]
    return {package, *map(Path, (sys.prefix, sys.base_prefix, sys.exec_prefix, *packages, *SYSTEM))}


def _restrict_files(libc: ctypes.CDLL, readable: Iterable[Path]) -> int:
    """Deny all file access except reading the files and folders in `readable`. Also deny TCP and signals if possible.

    Returns the kernel's Landlock version, or 0 if the kernel does not support Landlock.
    """
    version = libc.syscall(CREATE_RULESET, None, ctypes.c_size_t(0), ASK_FOR_VERSION)
    file_rights = (1 << FILE_RIGHTS + sum(version >= added for added in ADDED_IN)) - 1
    attributes = file_rights, TCP * (version >= TCP_SINCE), SCOPES * (version >= SCOPES_SINCE)
    handled = ctypes.create_string_buffer(struct.pack("=3Q", *attributes), 24)
    ruleset = libc.syscall(CREATE_RULESET, handled, ctypes.c_size_t(24), 0)
    if ruleset < 0:
        return 0
    try:
        for path in readable:
            try:
                place = os.open(path, os.O_PATH | os.O_CLOEXEC)
            except OSError:
                continue  # the path does not exist
            rights = READ_FILE | READ_FOLDER if path.is_dir() else READ_FILE
            rule = ctypes.create_string_buffer(struct.pack("=Qi", rights, place), 12)
            libc.syscall(ADD_RULE, ruleset, PATH_BENEATH, rule, 0)
            os.close(place)
        return int(version) if libc.syscall(RESTRICT_SELF, ruleset, 0) == 0 else 0
    finally:
        os.close(ruleset)


def _filter_system_calls() -> bool:
    """Deny system calls that affect anything outside the process. Return False if the system does not support seccomp."""
    if pyseccomp is None:
        return False
    itself, refuse = os.getpid(), pyseccomp.ERRNO(errno.EPERM)
    try:
        rules = pyseccomp.SyscallFilter(pyseccomp.ALLOW)
        for name in " ".join(DENIED.values()).split():
            with contextlib.suppress(OSError):  # the installed libseccomp may not support the system call
                rules.add_rule(refuse, name)
        # A filter cannot read the flags of `clone3`. With ENOSYS, the C library falls back to `clone`.
        rules.add_rule(pyseccomp.ERRNO(errno.ENOSYS), "clone3")
        rules.add_rule(refuse, "clone", pyseccomp.Arg(0, pyseccomp.MASKED_EQ, CLONE_THREAD, 0))
        for name, own in (("kill", itself), ("tgkill", itself), ("prlimit64", 0)):
            rules.add_rule(refuse, name, pyseccomp.Arg(0, pyseccomp.NE, own))
        rules.load()
    except OSError:  # the kernel has no seccomp filters
        return False
    return True


@isolated()
def measures(path: Path) -> tuple[str, ...]:
    """Return the names of the measures that `confine` has activated in a file's worker."""
    return _measures


def serve(socket_descriptor: int, arrays: int, cpu_seconds: float, max_bytes: int) -> None:
    """Serve decoding requests until the caller closes the connection. A separate worker process decodes each file.

    Parameters
    ----------
    socket_descriptor : int
        File descriptor of the socket that is connected to the caller.
    arrays : int
        File descriptor of the memory file through which decoded arrays are returned.
    cpu_seconds : float
        Maximum CPU time per request, in s.
    max_bytes : int
        Maximum address space of a worker, and maximum size of a file that it writes, in bytes.
    """
    limits = {resource.RLIMIT_CORE: 0, resource.RLIMIT_AS: max_bytes, resource.RLIMIT_FSIZE: max_bytes}
    for what, most in limits.items():
        resource.setrlimit(what, 2 * (_allowed(what, most),))  # soft and hard limit, so that workers cannot raise it
    without_plots()
    workers: dict[str, _Worker] = {}  # file and decoder → worker, with the least recently used worker first
    with socket.socket(fileno=socket_descriptor) as connection:
        send(connection, READY)
        while True:
            try:
                request = receive(connection)
            except EOFError:
                return
            folder, state, module, name, path, *_ = json.loads(request)
            task = json.dumps([folder, state, module, name, path])
            if task not in workers:
                _import(module, name)
                try:
                    others = [connection, *(worker.socket for worker in workers.values())]
                    workers[task] = _Worker(Path(folder, path), arrays, cpu_seconds, others)
                except OSError:
                    problem = L3Error(f"the process that decodes {path} cannot start; {MORE_MEMORY}, or add ‹trust›")
                    send(connection, _problem(problem))
                    continue
            workers[task] = worker = workers.pop(task)
            send(connection, worker.answer(request))
            if len(workers) > MAX_WORKERS:
                workers.pop(next(iter(workers))).end()


def _import(module: str, name: str) -> None:
    """Import a decoder and its libraries before the workers are forked, so that workers need not import them."""
    with contextlib.suppress(Exception):  # the worker repeats the import and reports its error
        for library in getattr(importlib.import_module(module), name).libraries:
            importlib.import_module(library)


class _Worker:
    """A forked process that decodes one file and cannot read other inputs."""

    def __init__(self, path: Path, arrays: int, cpu_seconds: float, inherited: list[socket.socket]) -> None:
        """Fork the worker, which closes the sockets in `inherited`. Raises OSError if the process cannot start."""
        self.socket, theirs = socket.socketpair()
        with theirs:
            try:
                self._process = os.fork()
            except OSError:
                self.socket.close()
                raise
            if not self._process:
                try:
                    for other in (self.socket, *inherited):
                        other.close()
                    _decode(theirs, path, arrays, cpu_seconds)
                finally:
                    os._exit(1)

    def answer(self, request: bytes) -> bytes:
        """Return the worker's reply. If the worker has died, end this process with the same signal or exit code."""
        try:
            send(self.socket, request)
            return receive(self.socket)
        except (EOFError, ConnectionError):
            code = os.waitstatus_to_exitcode(os.waitpid(self._process, 0)[1])
            if code < 0:
                with contextlib.suppress(OSError):  # the handler of SIGKILL cannot be set
                    signal.signal(-code, signal.SIG_DFL)
                os.kill(os.getpid(), -code)
            os._exit(code)

    def end(self) -> None:
        """Kill the worker process immediately."""
        os.kill(self._process, signal.SIGKILL)
        os.waitpid(self._process, 0)
        self.socket.close()


def _decode(connection: socket.socket, path: Path, arrays: int, cpu_seconds: float) -> None:
    """Restrict this process to one file, answer requests for this file until the connection closes, and exit.

    The CPU time limit applies to each request separately.
    """
    global _measures
    _measures = confine([path])
    while True:
        try:
            folder, _, module, name, path_there, *plain = json.loads(receive(connection))
        except EOFError:
            os._exit(0)
        os.chdir(folder)  # use the caller's working directory, so that relative paths remain valid
        used = resource.getrusage(resource.RUSAGE_SELF)
        until = _allowed(resource.RLIMIT_CPU, int(used.ru_utime + used.ru_stime + cpu_seconds) + 1)
        resource.setrlimit(resource.RLIMIT_CPU, (until, resource.getrlimit(resource.RLIMIT_CPU)[1]))
        send(connection, _answer(module, name, Path(path_there), plain, arrays))


def _allowed(what: int, most: int) -> int:
    """Return `most`, or this process's hard limit for the resource `what` if that is smaller."""
    hard = resource.getrlimit(what)[1]
    return most if hard == resource.RLIM_INFINITY else min(most, hard)


def _answer(module: str, name: str, path: Path, plain: list[Any], arrays: int) -> bytes:
    try:
        value = getattr(importlib.import_module(module), name)(path, *plain)
        with open(arrays, "r+b", buffering=0, closefd=False) as stream:
            stream.seek(0)
            text = json.dumps(plain_of({"value": value}, stream)).encode()
        if len(text) <= MAX_REPLY:
            return text
        return _problem(InputFileError(f"{path} contains too many parts and is probably damaged; copy the file again"))
    except L3Error as error:
        return _problem(error)
    except MemoryError:
        return _problem(InputFileError(too_much(path)))
    except OSError as error:  # raised when arrays are written; decoders convert their own errors to InputFileError
        return _problem(
            InputFileError(f"{path}: the decoded content cannot be stored ({error.strerror or error}); free some memory")
        )


def _problem(error: L3Error) -> bytes:
    return json.dumps({"dict": {"error": type(error).__name__, "message": str(error)}}).encode()
