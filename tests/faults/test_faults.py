"""Every stage is killed at random times, runs on full and read-only disks, with vanishing or truncated inputs, and twice.

No data may be lost and no output may be incomplete. These tests kill each stage a few times. `make soak` kills each stage
forty times.
"""

import contextlib
import fcntl
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from l3cli.cli import run
from tests.helpers.calls import L3, Refused
from tests.helpers.forkserver import ForkServer
from tests.helpers.stages import PARALLEL, STAGES, Stage, contents, is_hidden, is_remnant, make_inputs

ENDED = {signal.SIGINT: (130, "l3: interrupted\n"), signal.SIGTERM: (143, "l3: terminated\n"), signal.SIGKILL: (-9, "")}


def stages(*names: str) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("stage", [stage for stage in STAGES if stage.name in names], ids=lambda stage: stage.name)


every_stage = pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder "in" of every stage's inputs."""
    return make_inputs(tmp_path_factory.mktemp("faults") / "in")


@pytest.fixture(scope="module")
def compared(inputs: Path) -> None:
    """The two evaluations that l3 compare takes."""

    for name in ("a", "b"):
        arguments = ["evaluate", str(inputs / "table.h5"), str(inputs / "unseen.h5"), "--json", "--backend", "reference"]
        with open(inputs / f"{name}.json", "w") as printed, contextlib.redirect_stdout(printed):
            assert run(arguments) == 0


@pytest.fixture(scope="module")
def has_small_disks(inputs: Path) -> bool:
    """Whether a folder may be given a disk of its own."""
    mount = ["unshare", "-rm", "mount", "-t", "tmpfs", "tmpfs", str(inputs)]
    return shutil.which("unshare") is not None and subprocess.run(mount, capture_output=True).returncode == 0


@pytest.fixture(scope="module")
def server(inputs: Path, compared: None, has_small_disks: bool) -> Iterator[ForkServer]:
    server = ForkServer(inputs.parent, has_small_disks)
    assert server.run("--version").code == 0  # it is ready: runs will be timed
    yield server
    server.close()


@pytest.fixture(scope="module")
def truth(server: ForkServer) -> Callable[[Stage], tuple[dict[str, bytes], str, float]]:
    """What an undisturbed run of a stage leaves and says, and how many seconds it takes."""
    runs: dict[str, tuple[dict[str, bytes], str, float]] = {}

    def ask(stage: Stage) -> tuple[dict[str, bytes], str, float]:
        if stage.name not in runs:
            clear(server)
            start = time.monotonic()
            ended = server.run(*stage.arguments)
            seconds = time.monotonic() - start
            assert (ended.code, ended.err) == (0, "")
            runs[stage.name] = contents(server.folder), ended.out, seconds
        return runs[stage.name]

    return ask


def clear(server: ForkServer) -> None:
    shutil.rmtree(server.folder / "out", ignore_errors=True)


# ---------------------------------------------------------------------------------------------------------- killed


def kill_once(stage: Stage, number: int, seed: int, server: ForkServer, truth: Callable) -> bool:
    """Kill a run at a random moment; whether it was still running. What must hold is asserted here."""
    whole, words, seconds = truth(stage)
    clear(server)
    moment = random.Random(f"{stage.name} {seed}").uniform(0, seconds)
    ended = server.run(*stage.arguments, kill=(moment, number))
    left = contents(server.folder)
    finished = {name: content for name, content in left.items() if not is_hidden(name) and not is_remnant(name)}
    assert all(whole[name] == content for name, content in finished.items())  # nothing half-written
    if ended.code != 0:
        outcome = (ended.code, ended.err.lstrip("\n"))
        if "--jobs" in stage.line and number == signal.SIGKILL:  # Python's keeper of semaphores, left alone, reports them
            outcome = (ended.code, "")
        elif "--jobs" in stage.line and ended.code > 0:  # a worker just starting may say, too, that nobody gives it work
            outcome = (ended.code, next(line for line in outcome[1].splitlines(keepends=True) if line.startswith("l3: ")))
        # When all is done and Python is about to end it, a signal ends it as any program: 128 + number for a shell, too.
        assert outcome == ENDED[signal.Signals(number)] or (outcome == (-number, "") and finished == whole)
        if number != signal.SIGKILL:
            assert [name for name in left if is_hidden(name) and not is_remnant(name)] == []
            assert [name for name in left if ".l3tmp" in name] == []
    again = server.run(*stage.arguments) if left == whole and whole else server.run(*stage.again)
    assert again.err.count("\n") <= 1
    assert again.code == 0 or (again.code == 1 and "--force" in again.err and finished == whole)
    if again.code == 0:
        assert again.out == words
    assert contents(server.folder) == whole
    return ended.code != 0


@stages("lab", "simulate", "train", "sequence", "video", "evaluate", "report")
def test_a_killed_run_leaves_nothing_that_the_next_does_not_fix(stage: Stage, server: ForkServer, truth: Callable) -> None:
    kill_once(stage, signal.SIGKILL, 0, server, truth)


@pytest.mark.soak
@pytest.mark.parametrize("stage", STAGES + PARALLEL, ids=lambda stage: stage.name)
def test_forty_killed_runs(stage: Stage, server: ForkServer, truth: Callable) -> None:
    signals = [signal.SIGKILL, signal.SIGTERM, signal.SIGKILL, signal.SIGINT]
    hit = sum(kill_once(stage, signals[seed % 4], seed, server, truth) for seed in range(100, 140))
    print(f"{stage.name}: 40 kills, {hit} while it ran, all mended")
    assert hit >= 20


# ------------------------------------------------------------------------------------------------ what a run depends on


@contextlib.contextmanager
def stopped_at_work(stage: Stage, server: ForkServer) -> Iterator[None]:
    """A run that stands still, its output claimed, while the block lasts."""
    while True:
        clear(server)
        child = server.start(*stage.arguments)
        while not (claimed := any(server.folder.glob("out/**/*.l3lock"))) and not any(server.folder.glob("out/*")):
            time.sleep(0.001)
        os.kill(child, signal.SIGSTOP)
        while state_of(child) not in "TtZ":  # a moment may pass until it stands still
            time.sleep(0.001)
        if claimed and any(is_held(path) for path in server.folder.glob("out/**/*.l3lock")):
            break
        os.kill(child, signal.SIGCONT)  # it was too quick, or had not got its lock yet
        server.wait()
    try:
        yield
    finally:
        os.kill(child, signal.SIGCONT)


def state_of(process: int) -> str:
    """Letter of a process's state, by the kernel; Z if there is none any more."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return "Z"


def is_held(lock: Path) -> bool:
    """Whether some process holds a lock."""
    with contextlib.suppress(FileNotFoundError), open(lock) as ours:
        try:
            fcntl.flock(ours, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


@stages("lab", "simulate", "sequence", "pattern", "evaluate")
def test_a_second_run_on_one_output_is_refused(
    stage: Stage, server: ForkServer, truth: Callable, monkeypatch: pytest.MonkeyPatch, l3: L3
) -> None:
    whole, _, _ = truth(stage)
    monkeypatch.chdir(server.folder)
    with stopped_at_work(stage, server):
        for more in ((), ("--force",), ("--resume",) if stage.resumes else ()):
            code, out, err = l3(*stage.arguments, *more)
            assert (code, out, err.count("\n")) == (1, "", 1)
            assert "is being written by another run" in err
    assert server.wait().code == 0
    assert contents(server.folder) == whole


@stages("calibrate", "train", "sequence")
def test_inputs_that_vanish_are_one_line(stage: Stage, server: ForkServer, truth: Callable) -> None:
    whole, _, _ = truth(stage)
    inputs, gone = server.folder / "in", server.folder / "gone"
    try:
        with stopped_at_work(stage, server):
            inputs.rename(gone)
        ended = server.wait()
    finally:
        gone.rename(inputs)
    left = contents(server.folder)
    assert ended.code in (0, 3)
    assert ended.err.count("\n") == (ended.code != 0)
    assert "Traceback" not in ended.err
    assert all(whole[name] == content for name, content in left.items() if not is_remnant(name))


@pytest.mark.parametrize(
    ("name", "stage"),
    [
        ("camera.h5", "simulate"),
        ("training.h5", "train"),
        ("table.h5", "still"),
        ("unseen.h5", "evaluate"),
        ("frames/f_3.tif", "sequence"),
        ("lab/white/*.tif", "calibrate"),
    ],
)
def test_an_input_cut_short_is_one_line(name: str, stage: str, server: ForkServer, truth: Callable) -> None:
    case = next(each for each in STAGES if each.name == stage)
    path, (whole, _, _) = next((server.folder / "in").glob(name)), truth(case)
    content = path.read_bytes()
    try:
        for share in (0.0, 0.9999):
            path.write_bytes(content[: int(share * len(content))])
            clear(server)
            ended = server.run(*case.arguments)
            assert (ended.code, ended.out, ended.err.count("\n")) == (3, "", 1), ended.err
            assert path.name in ended.err
            left = contents(server.folder)
            assert all(whole[each] == left[each] for each in left if not is_remnant(each))
    finally:
        path.write_bytes(content)


# --------------------------------------------------------------------------------------------------- disks and folders


@pytest.fixture
def small_disks(server: ForkServer, has_small_disks: bool) -> ForkServer:
    """Runs whose output folder may be a disk of its own."""
    if not has_small_disks:
        pytest.skip("no small disk can be mounted here: unshare -rm mount -t tmpfs fails")
    return server


def fill_disk(stage: Stage, share: float, whole: dict[str, bytes], disks: ForkServer) -> bool:
    """Run a stage on a disk that holds this share of what it makes; whether that was too little."""
    size = sum(-(-len(content) // 4096) * 4096 for content in whole.values())
    ended = disks.run(*stage.arguments, disk=f"size={max(4096, int(share * size) // 4096 * 4096)}")
    finished = {name: size for name, size in ended.left.items() if not is_remnant(name)}
    assert all(len(whole[name]) == size for name, size in finished.items())
    if ended.code:
        assert (ended.code, ended.err.count("\n")) == (1, 1), ended.err
        assert "No space left on device" in ended.err
        assert "out/" in ended.err
    return ended.code != 0


@stages("simulate", "train", "still", "sequence", "video")
def test_a_full_disk_is_one_line(stage: Stage, small_disks: ForkServer, truth: Callable) -> None:
    assert fill_disk(stage, 0.4, truth(stage)[0], small_disks)


@pytest.mark.soak
@every_stage
def test_forty_full_disks(stage: Stage, small_disks: ForkServer, truth: Callable) -> None:
    rng, whole = random.Random(stage.name), truth(stage)[0]
    full = sum(fill_disk(stage, rng.uniform(0.01, 1.0), whole, small_disks) for _ in range(40))
    print(f"{stage.name}: 40 small disks, {full} of them full, one line each")
    assert full >= 20


@stages("lab", "simulate", "still", "video")
def test_a_read_only_folder_is_one_line(stage: Stage, small_disks: ForkServer) -> None:
    ended = small_disks.run(*stage.arguments, disk="ro")
    assert (ended.code, ended.out, ended.err.count("\n"), ended.left) == (1, "", 1, {})
    assert "out is not writable" in ended.err


def test_what_is_no_file_is_never_replaced(inputs: Path, tmp_path: Path, refused: Refused) -> None:
    os.mkfifo(tmp_path / "pipe.h5")
    training, classes = inputs / "training.h5", inputs / "classes.toml"
    assert "pipe" in refused(1, "train", training, "--classes", classes, "-o", tmp_path / "pipe.h5", "--force")


def test_a_full_stdout_is_one_line(inputs: Path) -> None:
    command = [sys.executable, "-c", "from l3cli.cli import main; main()", "info", str(inputs / "camera.h5")]
    with open("/dev/full", "w") as full:
        ended = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert (ended.returncode, ended.stderr.count("\n")) == (1, 1)
    assert ended.stderr.startswith("l3: input/output: No space left on device")


# ------------------------------------------------------------------------------------------------------------ workers


def kill_worker(stage: Stage, seed: int, server: ForkServer, truth: Callable) -> bool:
    """Kill one of a run's workers at a random moment; whether that ended the run. One process then goes on alone."""
    alone = STAGES[[each.line for each in STAGES].index(stage.line.removesuffix(" --jobs 2"))]
    whole, words, seconds = truth(alone)
    clear(server)
    child = server.start(*stage.arguments)
    while not (workers := workers_of(child)) and Path(f"/proc/{child}/stat").exists():
        time.sleep(0.01)
    time.sleep(random.Random(f"{stage.name} {seed}").uniform(0, 0.7 * seconds))
    with contextlib.suppress(ProcessLookupError):
        os.kill(workers[seed % len(workers)], signal.SIGKILL)
    ended = server.wait()
    left = contents(server.folder)
    finished = {name: content for name, content in left.items() if not is_remnant(name)}
    assert all(whole[name] == content for name, content in finished.items())
    assert [name for name in left if ".l3" in name] == []
    if ended.code:
        assert (ended.code, ended.err.count("\n")) == (1, 1)
        assert "a worker process was killed" in ended.err
        again = server.run(*alone.again)
        assert (again.code, again.out, again.err) == (0, words, "")
    assert contents(server.folder) == whole
    return ended.code != 0


def workers_of(process: int) -> list[int]:
    """The worker processes of a run."""
    children = Path(f"/proc/{process}/task/{process}/children")
    try:
        numbers = [int(number) for number in children.read_text().split()]
        return [number for number in numbers if "spawn_main" in Path(f"/proc/{number}/cmdline").read_text()]
    except OSError:
        return []


def test_a_worker_that_fails_is_one_line(server: ForkServer, truth: Callable) -> None:
    assert kill_worker(PARALLEL[2], 0, server, truth)


@pytest.mark.soak
@pytest.mark.parametrize("stage", PARALLEL, ids=lambda stage: stage.name)
def test_ten_failing_workers(stage: Stage, server: ForkServer, truth: Callable) -> None:
    ended = sum(kill_worker(stage, seed, server, truth) for seed in range(10))
    print(f"{stage.name}: 10 workers killed, {ended} runs ended by it, all mended")
