"""Worker processes: the same results in the same order, and no process remains after any type of end."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from l3cli.errors import L3Error
from l3cli.parallel import ordered_map, workers
from l3cli.physics import spectra
from tests.helpers.tasks import PATIENCE, here, refusing, squared

SCENES = 'exposure_share = [0.9]\n[[scene]]\nsource = "dead leaves"\nsize = [64, 96]\ncount = 400\n'


def dying(item: tuple[int, bytes]) -> int:
    number, _ = item
    if number == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def test_results_come_in_order_from_the_same_processes() -> None:
    assert list(ordered_map(squared, range(7), 1)) == [number**2 for number in range(7)]
    with workers(2) as pool:
        for _ in range(2):
            assert list(pool(squared, range(7))) == [number**2 for number in range(7)]


@pytest.mark.parametrize("guarded", [False, True])
def test_a_script_is_run_once(tmp_path: Path, guarded: bool) -> None:
    """Also one that calls l3cli on its top level; and the functions of one that guards itself are found all the same."""
    lines = ["from l3cli.parallel import ordered_map", "print('begun')"]
    if guarded:
        lines += ["def halved(number): return number / 2", "if __name__ == '__main__':"]
        lines += ["    print(list(ordered_map(halved, [2, 4], 2)), __file__)"]
    else:
        lines += ["print(list(ordered_map(abs, [-1, -2], 2)), __file__)"]
    script = tmp_path / "script.py"
    script.write_text("\n".join(lines))
    ended = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=PATIENCE)
    assert (ended.returncode, ended.stderr) == (0, "")
    words = ended.stdout.splitlines()
    assert words[-1] == (f"[1.0, 2.0] {script}" if guarded else f"[1, 2] {script}")
    assert guarded or words[:-1] == ["begun"]


def drawing(number: int) -> set[str]:
    """What a worker that has asked for a spectrum could draw plots and make tables with."""
    spectra.white_point("D65")
    return {"colour", "matplotlib.backends", "pandas.core"} & set(sys.modules)


def test_a_worker_imports_nothing_to_draw_with() -> None:
    assert list(ordered_map(drawing, [0], 2)) == [{"colour"}]


COUNTED = """
import sys
from l3cli import cli

def counted(arguments):
    import scipy.linalg
    from threadpoolctl import threadpool_info
    return max(library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas")

cli.run, sys.argv = counted, ["l3"]
cli.main()
"""


def test_the_number_of_cores_does_not_change_how_products_are_rounded() -> None:
    """Of some processors BLAS rounds otherwise in several threads, in which workers never compute."""
    environment = dict(os.environ) | {"OMP_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2"}
    assert subprocess.run([sys.executable, "-c", COUNTED], env=environment, timeout=PATIENCE).returncode == 1


@pytest.mark.usefixtures("same_workers")
def test_workers_that_tests_share_work_in_the_folder_of_the_caller(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in "ab"]
    for folder in folders:
        folder.mkdir()
        with contextlib.chdir(folder), workers(2) as pool:
            assert set(pool(here, range(4))) == {str(folder)}


def test_what_a_worker_raises_is_raised_in_place() -> None:
    with pytest.raises(L3Error, match="not 0"):
        list(ordered_map(refusing, range(3), 2))


@pytest.mark.parametrize("size", [0, 10**7], ids=["small", "sent while it dies"])
def test_a_worker_that_is_killed_is_reported_and_not_waited_for(size: int) -> None:
    with pytest.raises(L3Error, match="was killed"):
        list(ordered_map(dying, [(number, bytes(size)) for number in range(6)], 2))


def test_a_signal_that_falls_into_a_finaliser_is_not_lost() -> None:
    program = """
import signal, time
from l3cli import cli

class Finalised:
    def __del__(self):
        signal.raise_signal(signal.SIGTERM)
        time.sleep(0.01)

def work(*_, **__):
    Finalised()
    time.sleep(60)

cli.l3.main = work
cli.main()
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=PATIENCE)
    assert (ended.returncode, ended.stderr) == (143, "l3: terminated\n")


SET_UP = {
    "a class": "class Named:\n    def __set_name__(self, *_):\n        {}\nclass Owner:\n    mine = Named()\n",
    "a library": "try:\n    {}\nexcept BaseException as error:\n    raise ImportError('initialization failed') from error\n",
}


@pytest.mark.parametrize(("place", "number"), [*zip(SET_UP, [signal.SIGINT, signal.SIGTERM], strict=True)])
def test_a_signal_that_an_import_makes_another_error_of_is_one_line(number: int, place: str, tmp_path: Path) -> None:
    (tmp_path / "module.py").write_text(SET_UP[place].format(f"__import__('signal').raise_signal({int(number)})"))
    program = """
from l3cli import cli

@cli.l3.command
def work():
    import module

cli.COMMANDS["work"] = ""
cli.Pipeline.get_command = lambda *_: work
cli.main()
"""
    place_of = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    call = [sys.executable, "-c", program, "work"]
    ended = subprocess.run(call, capture_output=True, text=True, timeout=PATIENCE, env=place_of)
    code, word = (130, "interrupted") if number == signal.SIGINT else (143, "terminated")
    assert (ended.returncode, ended.stderr.strip()) == (code, f"l3: {word}")


@pytest.mark.parametrize(
    ("number", "code", "word"), [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")]
)
def test_a_signal_before_anything_is_imported_is_one_line(number: int, code: int, word: str) -> None:
    program = f"""
import signal, sys

class Finder:
    def find_spec(self, name, *_):
        if name == "click":
            signal.raise_signal({int(number)})

sys.meta_path.insert(0, Finder())
signal.signal(signal.SIGINT, signal.default_int_handler)
from l3cli.__main__ import main
main()
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=PATIENCE)
    assert (ended.returncode, ended.stdout, ended.stderr) == (code, "", f"l3: {word}\n")


@pytest.mark.parametrize(
    ("number", "code", "word"), [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")]
)
def test_a_signal_that_falls_into_the_import_of_h5py_waits(number: int, code: int, word: str) -> None:
    """Otherwise HDF5 would keep the converters of h5py, and call them after Python has ended."""
    program = f"""
import atexit, signal, time
from l3cli import cli

register = atexit.register

def disturbed(function, *arguments):
    if "converters" in function.__name__:
        signal.raise_signal({int(number)})
    return register(function, *arguments)

def work(*_, **__):
    atexit.register = disturbed
    import h5py
    time.sleep(60)

cli.l3.main = work
cli.main()
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=PATIENCE)
    assert (ended.returncode, ended.stderr.strip()) == (code, f"l3: {word}")


@pytest.mark.parametrize("call", ["pwrite", "ftruncate"])
def test_a_signal_that_falls_into_hdf5_waits_until_it_has_written(tmp_path: Path, call: str) -> None:
    """An exception out of what HDF5 calls would crash it, or be forgotten together with what was to be written."""
    program = f"""
import os, pathlib, signal, time
from unittest import mock
import numpy as np
from l3cli import cli
from l3cli.system import signals
from l3cli.artifacts import container

path, system = pathlib.Path("whole.h5"), os.{call}

def disturbed(*arguments):
    os.{call} = system
    signal.raise_signal(signal.SIGTERM)
    return system(*arguments)

def work(*_, **__):
    os.{call} = disturbed
    with container.new_file(path) as file:
        file["data"] = np.arange(1000)
    container.check(path, "")
    print("whole", flush=True)
    time.sleep(60)

mock.patch.object(signals, "RETRY_SECONDS", 2.0).start()
cli.l3.main = work
cli.main()
"""
    ended = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=PATIENCE)
    assert (ended.returncode, ended.stdout, ended.stderr) == (143, "whole\n", "l3: terminated\n")


def test_a_signal_that_falls_into_the_start_of_a_worker_waits() -> None:
    """A worker half started would wait for its beginning, the items for a worker, and the program for both."""
    program = """
import signal
from multiprocessing import util
from l3cli import cli
from l3cli.parallel import ordered_map

start = util.spawnv_passfds

def disturbed(path, arguments, descriptors):
    child = start(path, arguments, descriptors)
    if b"--multiprocessing-fork" in arguments or "--multiprocessing-fork" in arguments:
        signal.raise_signal(signal.SIGTERM)
    return child

def work(*_, **__):
    util.spawnv_passfds = disturbed
    list(ordered_map(len, (bytes(1 << 20) for _ in range(10_000)), 2))

cli.l3.main = work
if __name__ == "__main__":
    cli.main()
"""
    run = subprocess.Popen([sys.executable, "-c", program], stderr=subprocess.PIPE, text=True)
    try:
        assert run.communicate(timeout=PATIENCE) == (None, "l3: terminated\n")
    finally:
        run.kill()
    assert run.returncode == 143


def test_workers_end_when_their_parent_is_killed(bayer_recipe: Path, tmp_path: Path) -> None:
    run = _simulation(bayer_recipe, tmp_path)
    assert _workers(run.pid)
    run.kill()
    run.communicate(timeout=PATIENCE)
    _wait_until(lambda: not _workers(run.pid))


def _simulation(camera: Path, folder: Path) -> "subprocess.Popen[str]":
    """A run of `l3 simulate` with two workers at work, in another process group."""
    (folder / "scenes.toml").write_text(SCENES)
    command = ["simulate", "scenes.toml", "--camera", camera, "-o", "training.h5", "--jobs", "2", "--quiet"]
    run = subprocess.Popen(
        [sys.executable, "-c", "from l3cli.cli import main; main()", *map(str, command)],
        cwd=folder,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a background job's is ignored, and inherited
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    _wait_until(lambda: any(folder.glob("training.h5.parts/0*.h5")))
    return run


def _workers(group: int) -> list[str]:
    """Command lines of the worker processes of a group that still run."""
    workers_seen = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
                line = (entry / "cmdline").read_text()
            except OSError:  # it has ended meanwhile
                continue
            if int(fields[2]) == group and fields[0] != "Z" and "spawn_main" in line:
                workers_seen.append(line)
    return workers_seen


def _wait_until(done: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not done():
        assert time.monotonic() < end
        time.sleep(0.05)


CUT_OFF = """
import os, sys, threading, time
from pathlib import Path
from l3cli.errors import L3Error
from l3cli.parallel import workers

class Large:
    def __reduce__(self):  # called when the worker begins to send it
        Path("begun").touch()
        return bytes, (bytes(150_000_000),)

def large(number):
    return Large()

class Stopped(BaseException):
    pass

def take(results):
    try:
        next(results)
    except L3Error:
        pass  # its worker was ended

if __name__ == "__main__":
    for trial in range(6):
        try:
            with workers(2) as pool:
                threading.Thread(target=take, args=(pool(large, [trial]),)).start()
                while not Path("begun").exists():
                    time.sleep(0.001)
                time.sleep(0.03 + 0.03 * trial)
                raise Stopped
        except Stopped:
            Path("begun").unlink()
"""


def test_an_end_while_a_worker_sends_a_large_result_is_an_end(tmp_path: Path) -> None:
    """Half a result lies in the pipe: nobody waits for the rest."""
    (tmp_path / "cut_off.py").write_text(CUT_OFF)
    call = [sys.executable, "cut_off.py"]
    ended = subprocess.run(call, cwd=tmp_path, timeout=PATIENCE, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
