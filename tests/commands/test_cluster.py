"""Cluster: a dask scheduler with two workers produces the same bytes as a single process, even if a worker is killed.

Every error is reported in one line within a limited time.
"""

import contextlib
import logging
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import tifffile

from l3cli.artifacts.store import save
from l3cli.cli import run
from l3cli.errors import L3Error, RecipeError
from l3cli.parallel import cluster as elsewhere
from l3cli.parallel import workers
from l3cli.parallel.cluster import Scheduler
from l3cli.physics.stokes import STOKES
from l3cli.system.limits import ONE_BLAS_THREAD
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import BAYER
from tests.helpers.paths import PYTHONPATH
from tests.helpers.tables import random_table
from tests.helpers.tasks import PATIENCE, refusing, squared, stopping_once

WORKERS = 2
SCENES = """
illuminants = ["D65", "A"]
luminances_cd_m2 = [100.0]
exposure_share = [0.9]
[[scene]]
source = "dead leaves"
size = [32, 40]
count = 12
[[scene]]
source = "rgb"
file = "picture.png"
"""
CLASSES = "[classes]\npatch = 3\nlevels = 4\n[learning]\npatches = 52000\nfirst_draws = 1\ndraws = 1\n"  # two blocks
TWO_SETS = CLASSES + "noise_left = 0.1\n"
ROWS, COLS, FRAMES = 48, 64, 9
LYING_WORKER = """
import pathlib
from l3cli.parallel import cluster

class OnlyHere(Exception):
    def __init__(self, first, second):
        super().__init__(first)

class Unreadable:
    def __reduce__(self):
        return OnlyHere, ()

def fail():
    raise OnlyHere(1, 2)

LIES = {
    "a number": lambda: 5,
    "an empty list": lambda: [],
    "bytes": lambda: b"5",
    "an unreadable value": Unreadable,
    "an error of an unknown class": fail,
}
cluster._computed = lambda versions, content: LIES[pathlib.Path("lie").read_text()]()
"""
# Processes of dask sample what they do a hundred times a second, for a dashboard that nobody looks at here.
IDLE = {
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
    "DASK_DISTRIBUTED__ADMIN__SYSTEM_MONITOR__INTERVAL": "10s",
    "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "1s",
}
DASK = "import sys; sys.modules.update(matplotlib=None, pandas=None)\nfrom dask.__main__ import main\nmain()"


class Cluster:
    """A scheduler and its workers, which are processes of ours."""

    def __init__(self, folder: Path, *tls: object) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self.address = f"{'tls' if tls else 'tcp'}://127.0.0.1:{port}"
        self._folder, self._tls = folder, tls
        self._scheduler = ("scheduler", "--host", "127.0.0.1", "--port", port, "--protocol", self.address[:3])
        self.scheduler = self._start(*self._scheduler)
        self.workers: list[subprocess.Popen[bytes]] = []

    def add(self, count: int, *more: object) -> None:
        options = ("--nthreads", 1, "--no-nanny", "--local-directory", self._folder, *more)
        self.workers += [self._start("worker", self.address, *options) for _ in range(count)]

    def _start(self, *command: object) -> "subprocess.Popen[bytes]":
        place = {"PYTHONPATH": PYTHONPATH, **ONE_BLAS_THREAD, **IDLE}  # holds what the workers are to do
        line = [sys.executable, "-c", DASK, *command, "--no-dashboard", *self._tls]
        with open(self._folder / "log", "ab") as log:
            environment = {**os.environ, **place}
            return subprocess.Popen(list(map(str, line)), cwd=self._folder, stdout=log, stderr=log, env=environment)

    def end(self) -> None:
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()

    def restart(self) -> None:
        self.scheduler.kill()
        self.scheduler.wait()
        self.scheduler = self._start(*self._scheduler)

    def wait_for_scheduler(self) -> None:
        host, port = self.address.rpartition("/")[2].split(":")

        def answers() -> bool:
            with socket.socket() as probe:
                return probe.connect_ex((host, int(port))) == 0

        _wait_until(answers)


@contextlib.contextmanager
def a_cluster(folder: Path, count: int, *tls: object) -> Iterator[Cluster]:
    cluster = Cluster(folder, *tls)
    try:
        cluster.add(count)
        cluster.wait_for_scheduler()
        yield cluster
    finally:
        cluster.end()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with a_cluster(tmp_path_factory.mktemp("cluster"), WORKERS) as cluster:
        with workers(1, Scheduler(cluster.address)) as pool:
            _wait_until(lambda: len(set(pool(_process, range(8 * WORKERS)))) == WORKERS)
        yield cluster


@pytest.fixture(scope="module")
def made(bayer_recipe: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a single process makes: training.h5, table.h5, pictures/, video.y4m of frames/."""
    folder = tmp_path_factory.mktemp("made")
    from l3cli.io.pictures.registry import write_picture

    rng = np.random.default_rng(0)
    write_picture(folder / "picture.png", rng.integers(0, 256, (32, 40, 3), dtype=np.uint8))
    (folder / "scenes.toml").write_text(SCENES)
    (folder / "classes.toml").write_text(TWO_SETS)
    (folder / "frames").mkdir()
    for number in range(FRAMES):
        values = np.clip(rng.normal(400 + 100 * number, 200, (ROWS, COLS)), 0, 4095)
        values.astype("<u2").tofile(folder / "frames" / f"{number:04d}.raw")
    for command in (
        ("simulate", folder / "scenes.toml", "--camera", bayer_recipe, "-o", folder / "training.h5"),
        ("train", folder / "training.h5", "--classes", folder / "classes.toml", "-o", folder / "table.h5"),
        ("render", *frames(folder), "--exposure", 1, "-o", folder / "pictures"),
        ("render", *frames(folder), "-o", folder / "video.y4m"),
        ("render", *frames(folder), "-o", folder / "raw/####.dng", "--remosaic", "bayer"),
        ("render", *frames(folder), "-o", folder / "pages.tif", "--bits", 32, "--space", "acescg"),
    ):
        assert run([*map(str, command), "--quiet"]) == 0
    return folder


def frames(folder: Path) -> tuple[object, ...]:
    return folder / "table.h5", folder / "frames", "--size", f"{ROWS}x{COLS}"


def _process(item: int) -> int:
    time.sleep(0.01)
    return os.getpid()


def _wait_until(done: Callable[[], bool], pause: float = 0.05) -> None:
    end = time.monotonic() + PATIENCE
    while not done():
        assert time.monotonic() < end
        time.sleep(pause)


def _content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.glob("[!.]*")}


# ------------------------------------------------------------------------------------------------- the same bytes


def test_train_gives_the_same_bytes(cluster: Cluster, made: Path, tmp_path: Path, l3: L3) -> None:
    command = ("train", made / "training.h5", "--classes", made / "classes.toml", "-o", tmp_path / "table.h5")
    code, _, err = l3(*command, "--scheduler", cluster.address)
    assert code == 0, err
    assert (tmp_path / "table.h5").read_bytes() == (made / "table.h5").read_bytes()


def test_a_shard_gives_the_same_bytes(cluster: Cluster, made: Path, tmp_path: Path, l3: L3) -> None:
    (tmp_path / "classes.toml").write_text(CLASSES)
    command = ("train", made / "training.h5", "--classes", tmp_path / "classes.toml", "--shard", "2/2")
    for name, where in (("place", ()), ("there", ("--scheduler", cluster.address))):
        assert l3(*command, "-o", tmp_path / name, *where)[0] == 0
    assert (tmp_path / "place").read_bytes() == (tmp_path / "there").read_bytes()


def test_render_gives_the_same_bytes(cluster: Cluster, made: Path, tmp_path: Path, l3: L3) -> None:
    """Files that workers read, and frames that are sent to them because their exposure or white follows those before."""
    where = ("--scheduler", cluster.address)
    assert l3("render", *frames(made), "--exposure", 1, "-o", tmp_path / "pictures", *where)[0] == 0
    assert _content(tmp_path / "pictures") == _content(made / "pictures")
    assert l3("render", *frames(made), "-o", tmp_path / "video.y4m", *where)[0] == 0
    assert (tmp_path / "video.y4m").read_bytes() == (made / "video.y4m").read_bytes()
    for name, white, there in (("place", "auto", ()), ("there", "auto", where), ("named", "A", ()), ("sent", "A", where)):
        assert l3("render", *frames(made), "--exposure", 1, "--white", white, "-o", tmp_path / name, *there)[0] == 0
    assert _content(tmp_path / "place") == _content(tmp_path / "there") != _content(made / "pictures")
    assert _content(tmp_path / "named") == _content(tmp_path / "sent")
    assert l3("render", *frames(made), "-o", tmp_path / "raw/####.dng", "--remosaic", "bayer", *where)[0] == 0
    assert _content(tmp_path / "raw") == _content(made / "raw")
    pages = ("-o", tmp_path / "pages.tif", "--bits", 32, "--space", "acescg")
    assert l3("render", *frames(made), *pages, *where)[0] == 0
    assert (tmp_path / "pages.tif").read_bytes() == (made / "pages.tif").read_bytes()
    for name, there in (("filtered", ()), ("filtered_there", where)):
        assert l3("render", *frames(made), "--exposure", 1, "--temporal", "-o", tmp_path / name, *there)[0] == 0
    assert _content(tmp_path / "filtered") == _content(tmp_path / "filtered_there")


@pytest.mark.parametrize(("shown", "name"), [("dolp", "video.mkv"), ("aolp", "pages.tif"), ("stokes", "video.y4m")])
def test_pictures_of_polarisation_give_the_same_bytes(
    shown: str, name: str, cluster: Cluster, made: Path, tmp_path: Path, l3: L3
) -> None:
    """They are wider than the frames, since colour bars and panels are beside them. Here the frames are also rotated."""
    save(random_table(BAYER, patch=3, outputs=STOKES), tmp_path / "table.h5")
    (tmp_path / "frames").mkdir()
    for file in (made / "frames").iterdir():
        values = np.fromfile(file, "<u2").reshape(ROWS, COLS)
        tifffile.imwrite(tmp_path / "frames" / f"{file.stem}.tif", values, extratags=[(274, "H", 1, 6, True)])
    command = ("render", tmp_path / "table.h5", tmp_path / "frames", "--show", shown)
    for folder, where in (("place", ()), ("there", ("--scheduler", cluster.address))):
        code, _, err = l3(*command, "-o", tmp_path / folder / name, *where)
        assert code == 0, err
    assert (tmp_path / "place" / name).read_bytes() == (tmp_path / "there" / name).read_bytes()


def test_a_broken_frame_is_named_or_left_out(cluster: Cluster, made: Path, tmp_path: Path, l3: L3) -> None:
    shutil.copytree(made / "frames", tmp_path / "frames")
    (tmp_path / "frames/0003.raw").write_bytes(b"short")
    command = ("render", made / "table.h5", *frames(tmp_path)[1:], "--exposure", 1, "--scheduler", cluster.address)
    code, _, err = l3(*command, "-o", tmp_path / "stopped")
    assert (code, err.count("\n")) == (3, 1)
    assert "0003.raw" in err
    assert l3(*command, "-o", tmp_path / "pictures", "--skip-bad")[0] == 1
    whole = _content(made / "pictures")
    del whole["0003.png"]
    assert _content(tmp_path / "pictures") == whole


def test_what_a_frame_cannot_be_is_reported_of_the_first(cluster: Cluster, made: Path, tmp_path: Path, l3: L3) -> None:
    shutil.copytree(made / "frames", tmp_path / "frames")
    (tmp_path / "frames/0000.raw").write_bytes(bytes([255]) * (2 * ROWS * COLS))
    call = ("render", made / "table.h5", *frames(tmp_path)[1:], "--exposure", 1, "-o", tmp_path / "pictures")
    code, _, err = l3(*call, "--scheduler", cluster.address)
    assert code == 0
    assert "65535" in err


# ----------------------------------------------------------------------------------------------- what goes wrong


def test_what_a_worker_raises_is_raised_in_place(cluster: Cluster) -> None:
    with workers(1, Scheduler(cluster.address)) as pool:
        assert list(pool(squared, range(40))) == [number**2 for number in range(40)]
        with pytest.raises(L3Error, match="not 0"):
            list(pool(refusing, range(3)))
        assert list(pool(squared, range(4))) == [0, 1, 4, 9]


@pytest.fixture(scope="module")
def liar(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Cluster, Path]]:
    """A cluster whose only worker returns something else than it should, and the file that says what."""
    folder = tmp_path_factory.mktemp("liar")
    (folder / "lying.py").write_text(LYING_WORKER)
    with a_cluster(folder, 0) as cluster:
        cluster.add(1, "--preload", folder / "lying.py")
        yield cluster, folder / "lie"


@pytest.mark.parametrize(
    "lie", ["a number", "an empty list", "bytes", "an unreadable value", "an error of an unknown class"]
)
def test_a_worker_that_lies_is_named(
    lie: str, liar: tuple[Cluster, Path], made: Path, bayer_recipe: Path, tmp_path: Path, refused: Refused
) -> None:
    cluster, file = liar
    file.write_text(lie)
    commands = [
        ("simulate", made / "scenes.toml", "--camera", bayer_recipe, "-o", tmp_path / "training.h5"),
        ("train", made / "training.h5", "--classes", made / "classes.toml", "-o", tmp_path / "table.h5"),
        ("render", *frames(made), "-o", tmp_path / "video.y4m"),
    ]
    if lie != "bytes":  # the content of a picture file is not decoded
        commands.append(("render", *frames(made), "--exposure", 1, "-o", tmp_path / "pictures"))
    for command in commands:
        assert "worker tcp://127.0.0.1:" in refused(1, *command, "--scheduler", cluster.address)
    assert not [path for path in tmp_path.rglob("*") if path.suffix in (".h5", ".png", ".y4m") and path.is_file()]


def test_few_results_are_pending(cluster: Cluster) -> None:
    """Items are taken when there is room for them, not all at once."""
    taken: list[int] = []

    def items() -> Iterator[int]:
        for item in range(100):
            taken.append(item)
            yield item

    with workers(1, Scheduler(cluster.address)) as pool:
        results = pool(squared, items())
        assert next(results) == 0
        assert len(taken) <= 2 * (WORKERS + 1)
        assert list(results) == [number**2 for number in range(1, 100)]


@pytest.mark.soak
def test_the_items_of_a_worker_that_stops_answering_are_computed_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL", "10s")
    with a_cluster(tmp_path, WORKERS) as cluster, workers(1, Scheduler(cluster.address)) as pool:
        _wait_until(lambda: len(set(pool(_process, range(8 * WORKERS)))) == WORKERS)
        numbers = set(pool(stopping_once, [str(tmp_path / "stopped")] * 9))
    assert len(numbers) == 1
    assert 0 not in numbers


def test_a_worker_of_another_version_is_refused(cluster: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(elsewhere, "__version__", "0.0.1")
    with (
        workers(1, Scheduler(cluster.address)) as pool,
        pytest.raises(L3Error, match=r"a worker has l3cli \S+, but this machine has 0\.0\.1"),
    ):
        list(pool(squared, range(1)))


def test_a_run_over_tls_ends_without_workers_and_without_its_scheduler(
    tmp_path: Path, bayer_recipe: Path, made: Path, l3: L3, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No worker; one with a certificate gives the same bytes; one is lost at work; the scheduler restarts; it is gone."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    ca, certificate, key = (tmp_path / name for name in ("ca.pem", "certificate.pem", "key.pem"))
    new = ("openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2")
    subprocess.run([*new, "-subj", "/CN=localhost", "-keyout", key, "-out", certificate], check=True, capture_output=True)
    shutil.copy(certificate, ca)  # it signs itself
    monkeypatch.setattr(elsewhere, "ANSWER_SECONDS", 2.0)
    with a_cluster(tmp_path, 0, "--tls-ca-file", ca, "--tls-cert", certificate, "--tls-key", key) as cluster:
        there = Scheduler(cluster.address, ca, certificate, key)
        with monkeypatch.context() as hasty:
            hasty.setattr(elsewhere, "WORKERLESS_SECONDS", 1.0)
            with pytest.raises(L3Error, match="no worker for 1 s"), workers(1, there):
                pass
        cluster.add(1)
        tls = ("--scheduler", cluster.address, "--tls-ca", ca, "--tls-cert", certificate, "--tls-key", key)
        command = ("simulate", made / "scenes.toml", "--camera", bayer_recipe, "-o", tmp_path / "training.h5", "--quiet")
        assert l3(*command, *tls)[::2] == (0, "")
        assert (tmp_path / "training.h5").read_bytes() == (made / "training.h5").read_bytes()
        with workers(1, there) as pool, monkeypatch.context() as hasty:
            hasty.setattr(elsewhere, "WORKERLESS_SECONDS", 1.0)
            with pytest.raises(L3Error, match="no worker for 1 s"):
                _go_on(pool(_process, range(10_000)), cluster.workers[0].kill)
        cluster.add(1)
        logged: list[logging.LogRecord] = []
        handler = logging.Handler()
        monkeypatch.setattr(handler, "emit", logged.append)
        logging.getLogger("distributed.client").addHandler(handler)
        with workers(1, there) as pool, pytest.raises(L3Error, match="the scheduler has stopped"):
            _go_on(pool(_process, range(10_000)), cluster.restart)
        logging.getLogger("distributed.client").removeHandler(handler)
        assert not logged
        cluster.scheduler.kill()
        cluster.scheduler.wait()
        with pytest.raises(L3Error, match="does not respond"), workers(1, there):
            pass


def _go_on(results: Iterator[object], fault: Callable[[], None]) -> None:
    """Take all results; after the first the fault comes."""
    next(results)
    fault()
    for _ in results:
        pass


# ------------------------------------------------------------------------------------------- doors and their keys


def test_wrong_doors_are_one_line(
    made: Path, bayer_recipe: Path, tmp_path: Path, refused: Refused, monkeypatch: pytest.MonkeyPatch
) -> None:
    pem = tmp_path / "ca.pem"
    pem.write_text("no certificate")
    run = ("simulate", made / "scenes.toml", "--camera", bayer_recipe, "-o", tmp_path / "no.h5")
    tls = ("--tls-ca", pem, "--tls-cert", pem, "--tls-key", pem)
    assert "--scheduler" in refused(2, *run, *tls)
    assert "--jobs" in refused(2, *run, "--scheduler", "tcp://127.0.0.1:1", "--jobs", 2)
    for address in ("127.0.0.1:8786", "http://127.0.0.1:8786", "tcp://127.0.0.1", "tcp://127.0.0.1:99999"):
        assert address in refused(2, *run, "--scheduler", address)
    assert "--tls-ca" in refused(2, *run, "--scheduler", "tls://127.0.0.1:1")
    assert "tcp://127.0.0.1:1" in refused(2, *run, "--scheduler", "tcp://127.0.0.1:1", *tls)
    absent = (*tls[:-1], tmp_path / "absent.pem")
    assert "absent.pem" in refused(3, *run, "--scheduler", "tls://127.0.0.1:1", *absent)
    assert "--tls-ca" in refused(3, *run, "--scheduler", "tls://127.0.0.1:1", *tls)
    monkeypatch.setattr(elsewhere, "ANSWER_SECONDS", 1.0)
    assert "tcp://127.0.0.1:1" in refused(1, *run, "--scheduler", "tcp://127.0.0.1:1")
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert 'pip install "l3cli[cluster]"' in refused(1, *run, "--scheduler", "tcp://127.0.0.1:1")
    assert "--merge" in refused(
        2, "train", "--merge", made / "training.h5", "-o", tmp_path / "no.h5", "--scheduler", "tcp://127.0.0.1:1"
    )
    with pytest.raises(RecipeError):
        Scheduler("tcp://:8786x")


@pytest.mark.parametrize(
    ("address", "close"),
    [
        ("tcp://127.0.0.1:8786", True),
        ("tcp://127.8.8.8:1", True),
        ("tcp://[::1]:8786", True),
        ("tcp://localhost:8786", True),
        ("tcp://10.0.0.1:8786", False),
        ("tcp://0.0.0.0:8786", False),
        ("tcp://[2001:db8::1]:8786", False),
        ("tcp://cluster.example:8786", False),
    ],
)
def test_what_listens_on_this_machine_alone_is_known(address: str, close: bool) -> None:
    assert elsewhere._is_loopback(address) == close


def test_a_scheduler_open_to_others_is_warned_of(cluster: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    warnings: list[str] = []
    with workers(1, Scheduler(cluster.address, warn=warnings.append)):
        assert warnings == []
    monkeypatch.setattr(elsewhere, "_is_loopback", lambda address: False)
    with workers(1, Scheduler(cluster.address, warn=warnings.append)):
        assert warnings == [elsewhere.WITHOUT_TLS]


def test_simulate_gives_the_same_bytes_when_a_worker_is_killed(
    cluster: Cluster, made: Path, bayer_recipe: Path, tmp_path: Path, l3: L3
) -> None:
    """It is killed while it works and holds results; dask has others do its work again. The last test: none has two workers
    after it."""
    command = ("simulate", made / "scenes.toml", "--camera", bayer_recipe, "-o", tmp_path / "training.h5", "--quiet")
    left: list[int] = []

    def kill() -> None:
        parts = tmp_path / "training.h5.parts"
        _wait_until(lambda: len(list(parts.glob("*.h5"))) >= 4, 0.005)
        cluster.workers[0].kill()
        left.append(26 - len(list(parts.glob("*.h5"))))

    killer = threading.Thread(target=kill)
    killer.start()
    assert l3(*command, "--scheduler", cluster.address) == (0, "", "")
    killer.join()
    assert left[0] > 2  # it was killed while there was work
    assert (tmp_path / "training.h5").read_bytes() == (made / "training.h5").read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == ["training.h5"]
