"""The workers of a dask scheduler, on other machines, as a pool."""

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
from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.parallel import WorkerPool
from l3cli.system.limits import ONE_BLAS_THREAD

T = TypeVar("T")
R = TypeVar("R")

ANSWER = 10.0  # seconds in which a scheduler must answer
PATIENCE = 60.0  # seconds without any worker after which a run is given up
PULSE = 1.0  # seconds between checks of the workers
INSTALL = '‹scheduler› needs dask; install it with: pip install "l3cli[cluster]"'
WITHOUT_TLS = "the scheduler listens beyond this machine without TLS: who reaches it can run programs as you; see ‹tls_ca›"
_one_at_a_time = threading.Lock()


@dataclass(frozen=True)
class Scheduler:
    """A scheduler of dask.distributed, and the PEM files with which one that speaks TLS is met."""

    address: str  # tcp://HOST:PORT or tls://HOST:PORT
    ca: Path | None = None  # the authority that both sides trust
    certificate: Path | None = None  # ours, and its key
    key: Path | None = None
    warn: Callable[[str], None] = lambda message: None  # called if the scheduler is open to others

    def __post_init__(self) -> None:
        """Raise RecipeError if that is no address, or files are missing or given in vain."""
        match = re.fullmatch(r"(tcp|tls)://\S+:(\d{1,5})", self.address, re.ASCII)
        if not match or not 0 < int(match[2]) < 65536:
            raise RecipeError(f'"{self.address}" is not a scheduler\'s address; give tcp://HOST:PORT or tls://HOST:PORT')
        files = (self.ca, self.certificate, self.key)
        if match[1] == "tls" and None in files:
            raise RecipeError(f"{self.address} needs ‹tls_ca›, ‹tls_cert› and ‹tls_key›")
        if match[1] == "tcp" and files != (None, None, None):
            raise RecipeError(
                f"{self.address} speaks no TLS; give tls://HOST:PORT, or leave ‹tls_ca›, ‹tls_cert›, ‹tls_key› out"
            )
        for path in filter(None, files):
            if not path.is_file():
                raise InputFileError(f"{path} does not exist; give a PEM file")


@contextlib.contextmanager
def workers_of(scheduler: Scheduler) -> Iterator[WorkerPool]:
    """Yield the workers of a scheduler. L3Error if dask is missing, or the scheduler or every worker stays away.

    What is being done when the block fails is dropped; a worker ends the item it is at.
    """
    try:
        import dask
        import distributed
    except ModuleNotFoundError as error:
        raise L3Error(INSTALL) from error
    for name in ("distributed", "tornado", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # what goes wrong becomes one line
    settings = {
        "distributed.comm.timeouts.connect": f"{ANSWER} s",
        # An item holds what its worker needs; sent ahead, as dask advises, it would be lost with the worker that has it.
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
            client.close(timeout=ANSWER)


def _connected(distributed: Any, scheduler: Scheduler) -> Any:
    security = None
    if scheduler.ca is not None:
        files = {"tls_ca_file": scheduler.ca, "tls_client_cert": scheduler.certificate, "tls_client_key": scheduler.key}
        security = distributed.Security(require_encryption=True, **{name: str(path) for name, path in files.items()})
        try:
            security.get_connection_args("client")
        except OSError as error:
            raise InputFileError(f"‹tls_ca›, ‹tls_cert› or ‹tls_key› cannot be used ({error}); give PEM files") from error
    try:
        return distributed.Client(scheduler.address, security=security, timeout=ANSWER, set_as_default=False)
    except OSError as error:
        cure = "check its certificates and these" if security else "start one with: dask scheduler"
        raise L3Error(f"no scheduler answers at {scheduler.address}; {cure}") from error


def _is_loopback(address: str) -> bool:
    host = address.rpartition("://")[2].rpartition(":")[0].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host in ("", "localhost")


class _Workers:
    """Number of a scheduler's workers, checked once a PULSE."""

    def __init__(self, client: Any) -> None:
        self._client = client
        self._checked = -PULSE
        self._seen = time.monotonic()  # when there was a worker
        self._count = 0

    def first(self) -> int:
        """Return their number, as soon as there is one."""
        while not self.count():
            time.sleep(PULSE / 10)
        return self._count

    def count(self) -> int:
        """Return their number. L3Error if there has been none for longer than PATIENCE, or the scheduler is gone."""
        if time.monotonic() - self._checked >= PULSE:
            try:
                self._count = len(self._client.nthreads())
            except (OSError, RuntimeError, CancelledError) as error:
                raise L3Error(_GONE) from error
            self._checked = time.monotonic()
        if self._count:
            self._seen = self._checked
        elif time.monotonic() - self._seen > PATIENCE:
            raise L3Error(
                f"the scheduler has had no worker for {PATIENCE:.0f} s; start some with: dask worker ADDRESS --nthreads 1"
            )
        return self._count


_GONE = "the scheduler has gone; start it and its workers again"


def _sent_out(client: Any, workers: _Workers, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
    """Send items out, at most two a worker at a time; results stay with the workers until their turn comes."""

    def work(versions: dict[str, str], content: bytes) -> R:
        # Local, it travels by value and not by name, so that a worker without this l3cli can say so. It and the bytes are
        # passed on by the scheduler, which needs no l3cli.
        from l3cli.parallel.cluster import work_elsewhere

        return work_elsewhere(versions, content)

    waiting: collections.deque[Any] = collections.deque()
    try:
        for item in items:
            waiting.append(client.submit(work, _versions(), pickle.dumps((function, item)), pure=False))
            if len(waiting) >= 2 * max(1, workers.count()):
                yield _result(client, workers, waiting.popleft())
        while waiting:
            yield _result(client, workers, waiting.popleft())
    finally:
        for future in waiting:
            future.cancel()


def _result(client: Any, workers: _Workers, future: Any) -> Any:
    """Return a future's result, worked out again by dask where its worker has died; what `function` raised is raised."""
    from distributed import KilledWorker
    from distributed.comm import CommClosedError

    answer = asyncio.run_coroutine_threadsafe(client.gather(future, asynchronous=True), client.loop.asyncio_loop)
    try:
        while not answer.done():
            with contextlib.suppress(TimeoutError):
                answer.exception(PULSE)
            workers.count()
        return answer.result()
    except (CancelledError, asyncio.CancelledError, CommClosedError) as error:
        raise L3Error(_GONE) from error
    except ImportError as error:
        raise L3Error(f"a worker cannot import what it needs ({error}); install l3cli {__version__} there") from error
    except KilledWorker as error:
        raise L3Error("several workers died of the same item, perhaps for lack of memory; give them more") from error
    finally:
        answer.cancel()


def _versions() -> dict[str, str]:
    """Return the versions that must be equal here and there for the same bytes."""
    python = platform.python_version().rpartition(".")[0]
    return {"l3cli": __version__, "numpy": importlib.metadata.version("numpy"), "Python": python}


def work_elsewhere(versions: dict[str, str], content: bytes) -> Any:
    """Return, in a worker, function(item). One at a time, since not all that is called is safe in several threads."""
    for name, theirs in versions.items():
        if (ours := _versions()[name]) != theirs:
            raise L3Error(f"a worker has {name} {ours}, this machine {theirs}; install the same version on both")
    if any(os.environ.get(name) != number for name, number in ONE_BLAS_THREAD.items()):
        names = " ".join(f"{name}={number}" for name, number in ONE_BLAS_THREAD.items())
        raise L3Error(f"a worker computes in several threads, which may round otherwise; start it with {names}")
    function, item = pickle.loads(content)
    with _one_at_a_time:
        return function(item)


@contextlib.contextmanager
def scratch_folder() -> Iterator[Path]:
    """Yield, in a worker elsewhere, a folder for the block, among those that dask clears away after a killed worker."""
    from distributed import get_worker

    with tempfile.TemporaryDirectory(dir=get_worker().local_directory) as folder:
        yield Path(folder)
