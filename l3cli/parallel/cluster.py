"""Run work on dask workers on other machines."""

import asyncio
import collections
import contextlib
import functools
import importlib.metadata
import ipaddress
import logging
import os
import pickle
import platform
import re
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from l3cli import __version__
from l3cli.errors import MAX_CHARACTERS, InputFileError, L3Error, RecipeError
from l3cli.parallel.pool import WorkerPool
from l3cli.system.limits import ONE_BLAS_THREAD

T = TypeVar("T")
R = TypeVar("R")

ANSWER_SECONDS = 10.0  # time limit for a response from the scheduler
WORKERLESS_SECONDS = 60.0  # time without any worker after which a run fails
CHECK_SECONDS = 1.0  # interval between checks of the number of workers
INSTALL = '‹scheduler› needs dask; install it with: pip install "l3cli[cluster]"'
WITHOUT_TLS = (
    "the scheduler accepts connections from other machines without TLS, so other users can run programs under your account; "
    "use a tls:// address with ‹tls_ca›"
)
REPORTED = (L3Error, OSError, MemoryError)  # worker errors that l3 raises again, so that they are reported in one line
_one_at_a_time = threading.Lock()


@dataclass(frozen=True)
class Scheduler:
    """Address of a dask.distributed scheduler, and the PEM files for a TLS connection.

    Raises
    ------
    RecipeError
        If the address is invalid, if one of the three PEM files is missing for a tls:// address, or if there is one for a
        tcp:// address.
    InputFileError
        If a PEM file does not exist.
    """

    address: str  # tcp://HOST:PORT or tls://HOST:PORT
    ca: Path | None = None  # certificate of the authority that both sides trust
    certificate: Path | None = None  # certificate of this machine
    key: Path | None = None  # private key of the certificate
    warn: Callable[[str], None] = lambda message: None  # called with a warning if other machines can connect without TLS

    def __post_init__(self) -> None:
        match = re.fullmatch(r"(tcp|tls)://\S+:(\d{1,5})", self.address, re.ASCII)
        if not match or not 0 < int(match[2]) < 65536:
            raise RecipeError(f'"{self.address}" is not a scheduler address; use tcp://HOST:PORT or tls://HOST:PORT')
        files = (self.ca, self.certificate, self.key)
        if match[1] == "tls" and None in files:
            raise RecipeError(f"{self.address} needs ‹tls_ca›, ‹tls_cert› and ‹tls_key›; set all three options")
        if match[1] == "tcp" and files != (None, None, None):
            raise RecipeError(
                f"{self.address} does not use TLS; use tls://HOST:PORT, or remove ‹tls_ca›, ‹tls_cert› and ‹tls_key›"
            )
        for path in filter(None, files):
            if not path.is_file():
                raise InputFileError(f"{path} does not exist; use a PEM file")


@contextlib.contextmanager
def workers_of(scheduler: Scheduler) -> Iterator[WorkerPool]:
    """Context manager that connects to a scheduler and yields its workers as a pool.

    If the block fails, each worker finishes its current item, and all waiting items are cancelled.

    Raises
    ------
    L3Error
        If dask is not installed, if the scheduler does not respond, or if it has no worker for WORKERLESS_SECONDS.
    """
    try:
        import dask
        import distributed
    except ModuleNotFoundError as error:
        raise L3Error(INSTALL) from error
    # dask sets a level for each of these loggers, so setting the level of their parent would have no effect.
    for name in ("distributed", "distributed.client", "tornado", "tornado.application", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # l3 reports each error in one line
    settings = {
        "distributed.comm.timeouts.connect": f"{ANSWER_SECONDS} s",
        # Suppress dask's advice to scatter large items. l3 sends them directly, because scattered data die with a worker.
        "distributed.admin.large-graph-warning-threshold": "1 GiB",
    }
    with dask.config.set(settings):
        client = _connected(distributed, scheduler)
        try:
            listening = client.scheduler_info()["address"]
            if not (listening.startswith("tls://") or _is_loopback(listening)):
                scheduler.warn(WITHOUT_TLS)
            workers = _Workers(client)
            yield WorkerPool(workers.first(), functools.partial(_sent_out, client, workers))
        finally:
            client.close(timeout=ANSWER_SECONDS)


def _connected(distributed: Any, scheduler: Scheduler) -> Any:
    security = None
    if scheduler.ca is not None:
        files = {"tls_ca_file": scheduler.ca, "tls_client_cert": scheduler.certificate, "tls_client_key": scheduler.key}
        security = distributed.Security(require_encryption=True, **{name: str(path) for name, path in files.items()})
        try:
            security.get_connection_args("client")
        except OSError as error:
            raise InputFileError(
                f"‹tls_ca›, ‹tls_cert› or ‹tls_key› is not a valid PEM file ({error}); correct these options"
            ) from error
    try:
        return distributed.Client(scheduler.address, security=security, timeout=ANSWER_SECONDS, set_as_default=False)
    except OSError as error:
        cure = "check the certificates on both sides" if security else "start a scheduler with: dask scheduler"
        raise L3Error(f"the scheduler at {scheduler.address} does not respond; {cure}") from error


def _is_loopback(address: str) -> bool:
    host = address.rpartition("://")[2].rpartition(":")[0].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host in ("", "localhost")


class _Workers:
    """Counts a scheduler's workers. The scheduler is queried at most once per CHECK_SECONDS."""

    def __init__(self, client: Any) -> None:
        self._client = client
        self._checked = -CHECK_SECONDS
        self._seen = time.monotonic()  # last time at which the scheduler had a worker
        self._count = 0

    def first(self) -> int:
        """Wait for the first worker, and return the number of workers. Raises the same error as `count`."""
        while not self.count():
            time.sleep(CHECK_SECONDS / 10)
        return self._count

    def count(self) -> int:
        """Return the number of workers.

        Raises L3Error if the scheduler does not respond, or if it has had no worker for WORKERLESS_SECONDS.
        """
        if time.monotonic() - self._checked >= CHECK_SECONDS:
            try:
                self._count = len(self._client.nthreads())
            except (OSError, RuntimeError, CancelledError) as error:
                raise L3Error(_GONE) from error
            self._checked = time.monotonic()
        if self._count:
            self._seen = self._checked
        elif time.monotonic() - self._seen > WORKERLESS_SECONDS:
            raise L3Error(
                f"the scheduler has had no worker for {WORKERLESS_SECONDS:.0f} s; start workers with: "
                "dask worker ADDRESS --nthreads 1"
            )
        return self._count


_GONE = "the scheduler has stopped; start it and its workers again"


def _sent_out(
    client: Any, workers: _Workers, function: Callable[[T], R], items: Iterable[T], fits: Callable[[T, R], bool]
) -> Iterator[R]:
    """Compute function(item) for each item on the workers, and yield the results in the order of the items.

    At most two items per worker are submitted at a time. A result stays on its worker until the caller needs it. If the
    caller stops early, the unfinished items are cancelled.

    Raises
    ------
    L3Error
        If the scheduler or all workers have stopped, if a worker uses different software versions, if the function fails,
        or if `fits` rejects a result.
    """

    def work(versions: dict[str, str], content: bytes) -> bytes:
        # dask sends the code of a local function, not its name. Even a worker without l3cli can therefore run this line and
        # report the missing package. The scheduler does not need l3cli, because it only forwards bytes.
        from l3cli.parallel.cluster import work_elsewhere

        return work_elsewhere(versions, content)

    waiting: collections.deque[tuple[T, Any]] = collections.deque()

    def result() -> R:
        item, future = waiting.popleft()
        answer = _answer(client, workers, future)
        return _opened(answer, lambda value: fits(item, value), lambda: _worker_of(client, future))

    try:
        for item in items:
            waiting.append((item, client.submit(work, _versions(), pickle.dumps((function, item)), pure=False)))
            if len(waiting) >= 2 * max(1, workers.count()):
                yield result()
        while waiting:
            yield result()
    finally:
        for _, future in waiting:
            future.cancel()


def _answer(client: Any, workers: _Workers, future: Any) -> Any:
    """Wait for a worker's answer. If the worker dies, dask computes the item on another worker.

    Raises L3Error if the scheduler or all workers have stopped, if a worker cannot import a module, if several workers died
    while computing this item, or if dask cannot read the answer.
    """
    from distributed import KilledWorker
    from distributed.comm import CommClosedError

    answer = asyncio.run_coroutine_threadsafe(client.gather(future, asynchronous=True), client.loop.asyncio_loop)
    try:
        while not answer.done():
            with contextlib.suppress(TimeoutError):
                answer.exception(CHECK_SECONDS)
            workers.count()
        return answer.result()
    except (CancelledError, asyncio.CancelledError, CommClosedError) as error:
        raise L3Error(_GONE) from error
    except ImportError as error:
        raise _missing(error) from error
    except KilledWorker as error:
        raise L3Error(
            "several workers died while computing the same item, perhaps because they ran out of memory; use workers with "
            "more memory"
        ) from error
    except L3Error:
        raise
    except Exception as error:  # dask cannot send or read the answer
        raise L3Error(f"a worker failed ({_line(error)}); see the workers' logs for the traceback") from error
    finally:
        answer.cancel()


def _opened(answer: Any, fits: Callable[[Any], bool], worker: Callable[[], str]) -> Any:
    """Unpack the answer from `work_elsewhere`, and return the result in it.

    Parameters
    ----------
    answer : bytes
        The answer. If a worker runs different code, it may be an object of any other type.
    fits : callable
        Function that returns whether a result has the expected types and shapes. It may raise any exception if the type is
        wrong.
    worker : callable
        Function that returns the worker's address, for messages.

    Raises
    ------
    L3Error, OSError or MemoryError
        If the worker failed, if its answer cannot be read, or if `fits` rejects the result.
    """
    try:
        failed, value = pickle.loads(answer)
    except Exception as error:
        raise L3Error(f"worker {worker()} returned an invalid reply ({_line(error)}); {_REPLACE}") from error
    if isinstance(value, ImportError):
        raise _missing(value)
    if failed and isinstance(value, REPORTED):
        raise value
    if failed:
        raise L3Error(f"worker {worker()} failed ({value}); see its log for the traceback")
    try:
        expected = fits(value)
    except Exception:  # `fits` may raise anything if the type is wrong
        expected = False
    if not expected:
        raise L3Error(f"worker {worker()} returned a result of the wrong type {type(value).__name__}; {_REPLACE}")
    return value


_REPLACE = "install the same version of l3cli on this worker, restart it, and run the command again"


def _missing(error: ImportError) -> L3Error:
    return L3Error(f"a worker cannot import a module ({error}); install l3cli {__version__} on all workers")


def _line(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"[:MAX_CHARACTERS]


def _worker_of(client: Any, future: Any) -> str:
    """Return the address of the worker that has computed a result, for messages."""
    try:
        return str(next(iter(client.who_has([future])[future.key])))
    except (OSError, RuntimeError, LookupError, StopIteration, CancelledError):  # the worker has stopped
        return "of an unknown address"


def _versions() -> dict[str, str]:
    """Return the software versions that affect the bytes of results, and must therefore be the same on all machines."""
    python = platform.python_version().rpartition(".")[0]
    return {"l3cli": __version__, "numpy": importlib.metadata.version("numpy"), "Python": python}


def work_elsewhere(versions: dict[str, str], content: bytes) -> bytes:
    """Compute function(item) on a worker.

    Parameters
    ----------
    versions : dict of str to str
        Software versions on the main machine, from `_versions`.
    content : bytes
        The pickled pair (function, item).

    Returns
    -------
    bytes
        The pickled pair (failed, value). `value` is the result or, if `failed` is true, the error. Errors of classes that
        are not in REPORTED are converted to text, because these classes may be missing on the main machine.

    Notes
    -----
    The result is pickled here, and not by dask, because dask could wait forever for an object that cannot be unpickled.
    """
    try:
        return pickle.dumps((False, _computed(versions, content)))
    except (*REPORTED, ImportError) as error:
        return pickle.dumps((True, error))
    except Exception as error:
        logging.getLogger(__name__).exception("an item of a run of l3 failed")
        return pickle.dumps((True, _line(error)))


def _computed(versions: dict[str, str], content: bytes) -> Any:
    """Check the worker, then compute function(item) for the pickled pair (function, item) in `content`.

    A worker computes one item at a time, because some functions are not thread-safe. Raises L3Error if this worker's
    software differs from `versions`, or if the worker uses several BLAS threads.
    """
    for name, theirs in versions.items():
        if (ours := _versions()[name]) != theirs:
            raise L3Error(f"a worker has {name} {ours}, but this machine has {theirs}; install the same version on both")
    if any(os.environ.get(name) != number for name, number in ONE_BLAS_THREAD.items()):
        names = " ".join(f"{name}={number}" for name, number in ONE_BLAS_THREAD.items())
        raise L3Error(f"a worker uses several BLAS threads, so its results may differ; start the worker with {names}")
    function, item = pickle.loads(content)
    with _one_at_a_time:
        return function(item)


@contextlib.contextmanager
def scratch_folder() -> Iterator[Path]:
    """Context manager that creates a temporary folder on a worker. If the worker is killed, dask removes the folder."""
    from distributed import get_worker

    with tempfile.TemporaryDirectory(dir=get_worker().local_directory) as folder:
        yield Path(folder)
