"""The one door to processes, other machines and threads: the same results in the same order whatever the workers."""

import asyncio
import collections
import contextlib
import functools
import importlib.metadata
import ipaddress
import logging
import multiprocessing
import os
import pickle
import platform
import queue
import re
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, TypeVar

from l3cli import __version__
from l3cli.errors import InputFileError, L3Error, RecipeError

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

T = TypeVar("T")
R = TypeVar("R")


def one_blas_thread() -> None:
    """Keep BLAS to one thread in this process and its children: small products are faster so, and the number of cores does
    not change how they are rounded. To be called before numpy is first imported; what the user has set himself stays."""
    for name, value in ONE_THREAD.items():
        os.environ.setdefault(name, value)


def ordered_map(function: Callable[[T], R], items: Iterable[T], jobs: int) -> Iterator[R]:
    """function(item) of every item, in order, by `jobs` processes (1: in this one).

    Processes are spawned, not forked: a fork after an OpenCL context exists hangs. Their BLAS is kept to one thread each.
    At most 2·jobs results wait, so memory is bounded by the workers, not by the number of items.
    """
    with workers(jobs) as crew:
        yield from crew(function, items)


@dataclass(frozen=True)
class Crew:
    """Workers that are handed items: crew(function, items) gives function(item) of every item, in order."""

    size: int  # that work at a time
    _map: Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[Any]]

    def __call__(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        return self._map(function, items)


@contextlib.contextmanager
def workers(jobs: int, scheduler: "Scheduler | None" = None) -> Iterator[Crew]:
    """`ordered_map` for several calls by the same processes, or by the workers of a scheduler."""
    if scheduler is not None:
        with _cluster(scheduler) as crew:
            yield crew
    elif jobs == 1:
        yield Crew(1, map)
    else:
        with _pool(jobs) as pool:
            yield Crew(jobs, functools.partial(_pooled, pool, 2 * jobs))


def alone(function: Callable[[T], R], item: T) -> R:
    """function(item) by a process of its own, whose memory nothing else has used."""
    with _pool(1) as pool:
        return _result(_submit(pool, function, item))


@contextlib.contextmanager
def _pool(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that end with the block: at once where it fails or is interrupted."""
    saved = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    pool = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), _end_with_parent)
    before = multiprocessing.active_children()
    try:
        yield pool
    except BaseException:
        for child in multiprocessing.active_children():
            if child not in before:
                child.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)
        for name, value in saved.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _submit(pool: ProcessPoolExecutor, function: Callable[[T], R], item: T) -> "Future[R]":
    """Hand an item to the pool, which may start a process for it: one that leaves Ctrl-C, which reaches the whole group, to
    its parent. A blocked signal is inherited from the first instruction on, and still reaches the parent afterwards."""
    old = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return pool.submit(function, item)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, old)


def _result(future: "Future[R]") -> R:
    try:
        return future.result()
    except BrokenProcessPool as error:
        raise L3Error("a worker process was ended from outside, perhaps for lack of memory; use fewer --jobs") from error


def _end_with_parent() -> None:
    """In a worker: end when the parent has, even if it was killed; nobody would take the results."""
    parent: Any = multiprocessing.parent_process()

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _pooled(pool: ProcessPoolExecutor, most: int, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
    waiting: collections.deque[Future[R]] = collections.deque()
    for item in items:
        waiting.append(_submit(pool, function, item))
        if len(waiting) >= most:
            yield _result(waiting.popleft())
    while waiting:
        yield _result(waiting.popleft())


# ------------------------------------------------------------------------------------------------- other machines

ANSWER = 10.0  # seconds in which a scheduler must answer
PATIENCE = 60.0  # seconds without any worker after which a run is given up
PULSE = 1.0  # seconds between looks at the workers
INSTALL = '--scheduler needs dask; install it with: pip install "l3cli[cluster]"'
WITHOUT_TLS = "the scheduler listens beyond this machine without TLS: who reaches it can run programs as you; see --tls-ca"
_one_at_a_time = threading.Lock()


@dataclass(frozen=True)
class Scheduler:
    """A scheduler of dask.distributed, and the PEM files with which one that speaks TLS is met."""

    address: str  # tcp://HOST:PORT or tls://HOST:PORT
    ca: Path | None = None  # the authority that both sides trust
    certificate: Path | None = None  # ours, and its key
    key: Path | None = None
    warn: Callable[[str], None] = lambda message: None  # told that the scheduler is open to others

    def __post_init__(self) -> None:
        """RecipeError if that is no address, or files are missing or given in vain."""
        found = re.fullmatch(r"(tcp|tls)://\S+:(\d{1,5})", self.address, re.ASCII)
        if not found or not 0 < int(found[2]) < 65536:
            raise RecipeError(f'"{self.address}" is no scheduler\'s address; give tcp://HOST:PORT or tls://HOST:PORT')
        files = (self.ca, self.certificate, self.key)
        if found[1] == "tls" and None in files:
            raise RecipeError(f"{self.address} needs --tls-ca, --tls-cert and --tls-key")
        if found[1] == "tcp" and files != (None, None, None):
            raise RecipeError(
                f"{self.address} speaks no TLS; give tls://HOST:PORT, or leave --tls-ca, --tls-cert, --tls-key out"
            )
        for path in filter(None, files):
            if not path.is_file():
                raise InputFileError(f"{path} does not exist; give a PEM file")


@contextlib.contextmanager
def _cluster(scheduler: Scheduler) -> Iterator[Crew]:
    """The workers of a scheduler. L3Error if dask is missing, or the scheduler or every worker stays away.

    What is under way when the block fails is dropped; a worker ends the item it is at.
    """
    try:
        import dask
        import distributed
    except ImportError as error:
        raise L3Error(INSTALL) from error
    for name in ("distributed", "tornado", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # what goes wrong is told in one line
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
            hands = _Hands(client)
            yield Crew(hands.first(), functools.partial(_sent_out, client, hands))
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
            raise InputFileError(f"--tls-ca, --tls-cert or --tls-key cannot be used ({error}); give PEM files") from error
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


class _Hands:
    """How many workers a scheduler has; looked at once a PULSE."""

    def __init__(self, client: Any) -> None:
        self._client = client
        self._looked = -PULSE
        self._seen = time.monotonic()  # when there was a worker
        self._count = 0

    def first(self) -> int:
        """Their number, as soon as there is one."""
        while not self.count():
            time.sleep(PULSE / 10)
        return self._count

    def count(self) -> int:
        """Their number. L3Error if there has been none for longer than PATIENCE, or the scheduler is gone."""
        if time.monotonic() - self._looked >= PULSE:
            try:
                self._count = len(self._client.nthreads())
            except (OSError, RuntimeError, CancelledError) as error:
                raise L3Error(_GONE) from error
            self._looked = time.monotonic()
        if self._count:
            self._seen = self._looked
        elif time.monotonic() - self._seen > PATIENCE:
            raise L3Error(
                f"the scheduler has had no worker for {PATIENCE:.0f} s; start some with: dask worker ADDRESS --nthreads 1"
            )
        return self._count


_GONE = "the scheduler has gone; start it and its workers again"


def _sent_out(client: Any, hands: _Hands, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
    """At most two items a worker are out at a time; results stay with the workers until their turn comes."""

    def work(versions: dict[str, str], content: bytes) -> R:
        # Local, it travels by value and not by name, so that a worker without this l3cli can say so. It and the bytes are
        # passed on by the scheduler, which needs no l3cli.
        from l3cli.parallel import work_elsewhere

        return work_elsewhere(versions, content)

    waiting: collections.deque[Any] = collections.deque()
    try:
        for item in items:
            waiting.append(client.submit(work, _versions(), pickle.dumps((function, item)), pure=False))
            if len(waiting) >= 2 * max(1, hands.count()):
                yield _brought(client, hands, waiting.popleft())
        while waiting:
            yield _brought(client, hands, waiting.popleft())
    finally:
        for future in waiting:
            future.cancel()


def _brought(client: Any, hands: _Hands, future: Any) -> Any:
    """A future's result, worked out again by dask where its worker has died; what `function` raised is raised."""
    from distributed import KilledWorker
    from distributed.comm import CommClosedError

    answer = asyncio.run_coroutine_threadsafe(client.gather(future, asynchronous=True), client.loop.asyncio_loop)
    try:
        while not answer.done():
            with contextlib.suppress(TimeoutError):
                answer.exception(PULSE)
            hands.count()
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
    """What must be the same here and there for the same bytes."""
    python = platform.python_version().rpartition(".")[0]
    return {"l3cli": __version__, "numpy": importlib.metadata.version("numpy"), "Python": python}


def work_elsewhere(versions: dict[str, str], content: bytes) -> Any:
    """In a worker: function(item). One at a time, since not all that is called is safe in several threads."""
    for name, there in versions.items():
        if (here := _versions()[name]) != there:
            raise L3Error(f"a worker has {name} {here}, this machine {there}; install the same version on both")
    if any(os.environ.get(name) != number for name, number in ONE_THREAD.items()):
        names = " ".join(f"{name}={number}" for name, number in ONE_THREAD.items())
        raise L3Error(f"a worker computes in several threads, which may round otherwise; start it with {names}")
    function, item = pickle.loads(content)
    with _one_at_a_time:
        return function(item)


@contextlib.contextmanager
def scratch_folder() -> Iterator[Path]:
    """In a worker elsewhere: a folder for the block, among those that dask clears away after a worker that was killed."""
    from distributed import get_worker

    with tempfile.TemporaryDirectory(dir=get_worker().local_directory) as folder:
        yield Path(folder)


# ------------------------------------------------------------------------------------------------------- threads


class _End(Exception):
    """Put behind the last item of a queue."""


def ahead(items: Iterable[T], depth: int) -> Iterator[T]:
    """The same items, made by a thread of their own at most `depth` ahead of who takes them."""
    ready: queue.Queue[Any] = queue.Queue()
    room = threading.Semaphore(depth)
    stopped = threading.Event()

    def work() -> None:
        try:
            for item in _while_room(items, room, stopped):
                ready.put((item, None))
            ready.put((None, _End()))
        except BaseException as error:
            ready.put((None, error))

    # A daemon: one that waits for a stream that never comes must not keep the program from ending.
    threading.Thread(target=work, daemon=True).start()
    try:
        while True:
            item, error = ready.get()
            if isinstance(error, _End):
                return
            if error is not None:
                raise error
            yield item
            room.release()
    finally:
        stopped.set()
        room.release()


def _while_room(items: Iterable[T], room: threading.Semaphore, stopped: threading.Event) -> Iterator[T]:
    iterator = iter(items)
    while True:
        room.acquire()  # before an item is made: `depth` counts those in the making
        if stopped.is_set():
            return
        try:
            item = next(iterator)
        except StopIteration:
            return
        yield item


class Behind:
    """Calls function(item) in threads of their own, at most `depth` items behind; in order if there is one thread.

    As a context manager it waits for the last item, also when the block fails. What goes wrong is raised by the next
    `put`, or at the end; after that, or when the block is interrupted, what waits is dropped.
    """

    def __init__(self, function: Callable[[T], object], depth: int, threads: int = 1) -> None:
        self._function = function
        self._items: queue.Queue[Any] = queue.Queue(depth)
        self._error: BaseException | None = None
        self._threads = [threading.Thread(target=self._work, daemon=True) for _ in range(threads)]

    def __enter__(self) -> "Behind":
        for thread in self._threads:
            thread.start()
        return self

    def put(self, item: Any) -> None:
        if self._error is not None:
            raise self._error
        self._items.put(item)

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is not None and not isinstance(error, Exception):
            self._error = self._error or error
        for _ in self._threads:
            self._items.put(_End)
        for thread in self._threads:
            thread.join()
        if error is None and self._error is not None:
            raise self._error

    def _work(self) -> None:
        while (item := self._items.get()) is not _End:
            if self._error is not None:
                continue  # emptied, so that nobody waits to put
            try:
                self._function(item)
            except BaseException as error:
                self._error = error
