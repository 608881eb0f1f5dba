"""Fixtures of all tests: a small camera, training set and table, made by the commands of l3."""

import atexit
import contextlib
import fcntl
import functools
import gc
import os
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.cli import run, terminal
from l3cli.parallel import processes
from l3cli.physics.spectra import colour_science
from tests.helpers.cameras import bayer_camera
from tests.helpers.paths import CONFIGS, PYTHONPATH
from tests.helpers.recipes import CLASSES, GAIN_CLASSES, SCENES, UNSEEN
from tests.helpers.tasks import in_folder

# Tests need no flushed data. Flushing takes 5 ms or more on many disks, which is longer than a small command.
os.fsync = lambda fd: None
settings.register_profile(
    "shared machines", max_examples=40, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("shared machines")
# colour-science imports matplotlib if matplotlib is installed, which takes longer than all its other imports. l3 does not
# need matplotlib.
with pytest.MonkeyPatch.context() as hidden:
    hidden.setitem(sys.modules, "matplotlib", None)
    colour_science()
# No garbage is collected while pytest collects tests. This saves a quarter of the processor time.
gc.disable()


def pytest_collection_finish() -> None:
    gc.freeze()
    atexit.register(gc.unfreeze)
    gc.enable()


@pytest.fixture(scope="session", autouse=True)
def environment_of_processes() -> None:
    """Set the environment in which tests start other processes.

    The width of 80 columns, which pytest-xdist sets, is removed. PYTHONPATH hides matplotlib from colour-science, because
    its import is slow. SIGINT gets its default action, because tests send SIGINT to processes.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # in jobs that a shell runs in the background
        signal.signal(signal.SIGINT, signal.default_int_handler)
    for name in ("COLUMNS", "LINES"):
        os.environ.pop(name, None)
    os.environ["PYTHONPATH"] = PYTHONPATH


@pytest.fixture(scope="session")
def fiveband() -> CameraModel:
    """The camera of configs/cameras/fiveband.toml."""
    return load_camera(CONFIGS / "cameras/fiveband.toml")


@pytest.fixture
def l3(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[int, str, str]]:
    """Function that runs `l3 ARGUMENTS` without progress lines and returns the exit code, stdout and stderr."""
    monkeypatch.setattr(terminal, "SHORTEST_SILENCE", 3600.0)

    def call(*arguments: object) -> tuple[int, str, str]:
        capsys.readouterr()
        code = run([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


@pytest.fixture
def refused(l3: Callable[..., tuple[int, str, str]], tmp_path: Path) -> Callable[..., str]:
    """Function that runs `l3 ARGUMENTS`, which must fail with a given exit code, and returns the line on stderr.

    The command must print nothing else and must make no file below tmp_path.
    """

    def call(code: int, *arguments: object) -> str:
        before = sorted(tmp_path.rglob("*"))
        got, out, err = l3(*arguments)
        assert got == code, err
        assert out == ""
        assert err.startswith("l3: ")
        assert err.count("\n") == 1, err
        assert "Traceback" not in err
        assert sorted(tmp_path.rglob("*")) == before
        return err

    return call


@pytest.fixture(scope="session")
def two_processes() -> Iterator[Callable[..., Iterator[Any]]]:
    """The function `map` of two worker processes, which are started once for all tests."""
    with processes.several(2) as mapped:
        yield mapped


@pytest.fixture
def same_workers(two_processes: Callable[..., Iterator[Any]], monkeypatch: pytest.MonkeyPatch) -> None:
    """`--jobs 2` uses the processes of `two_processes`, because starting new processes is slow.

    The processes were started in the folder of another test. They change to the current folder for each call.
    """

    def several(jobs: int) -> contextlib.nullcontext[Callable[..., Iterator[Any]]]:
        assert jobs == 2
        folder = os.getcwd()
        return contextlib.nullcontext(
            lambda function, items: two_processes(functools.partial(in_folder, folder, function), items)
        )

    monkeypatch.setattr(processes, "several", several)


@pytest.fixture(scope="session")
def l3_data() -> Path:
    """The folder of real data. Without this folder, the test is skipped."""
    folder = Path(os.environ.get("L3_DATA", ""))
    if not os.environ.get("L3_DATA") or not folder.is_dir():
        pytest.skip("L3_DATA does not name the folder of real data")
    return folder


@pytest.fixture(scope="session")
def bayer_recipe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("camera") / "bayer.toml"
    path.write_text(bayer_camera())
    return path


@pytest.fixture(scope="session")
def bayer(bayer_recipe: Path) -> CameraModel:
    """A small Bayer camera."""
    return load_camera(bayer_recipe)


@pytest.fixture(scope="session")
def fine_bayer_recipe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recipe of the small Bayer camera with curves every 5 nm, the step of calibrated curves."""
    path = tmp_path_factory.mktemp("camera") / "bayer.toml"
    text = bayer_camera()
    assert "[400, 700, 10]" in text
    path.write_text(text.replace("[400, 700, 10]", "[400, 700, 5]"))
    return path


def made_once(name: str, make: Callable[[Path], None], factory: pytest.TempPathFactory) -> Path:
    """Return a new folder. The first worker process of a test run fills the folder, all other processes copy its folder."""
    of_run = factory.getbasetemp().parent if "PYTEST_XDIST_WORKER" in os.environ else factory.getbasetemp()
    made, copy = of_run / f"made-{name}", factory.mktemp(name) / name
    with open(of_run / f"{name}.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not made.exists():
            copy.mkdir()
            make(copy)
            shutil.copytree(copy, of_run / f"making-{name}")
            (of_run / f"making-{name}").rename(made)
        else:
            shutil.copytree(made, copy)
    return copy


@pytest.fixture(scope="session")
def lab_folder(fine_bayer_recipe: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The measurements of the small Bayer camera in the virtual lab. Its well saturates before its converter."""

    def make(folder: Path) -> None:
        assert run(["lab", str(fine_bayer_recipe), "-o", str(folder), "--quiet"]) == 0

    return made_once("lab", make, tmp_path_factory)


@pytest.fixture(scope="session")
def pipeline(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files of all stages, from camera.toml and lab/ to table.h5 and picture.png."""
    return made_once("pipeline", make_pipeline, tmp_path_factory)


def make_pipeline(folder: Path) -> None:
    for name, text in {"camera": bayer_camera(), "scenes": SCENES, "unseen": UNSEEN, "classes": CLASSES}.items():
        (folder / f"{name}.toml").write_text(text)

    def l3(*arguments: object) -> None:
        assert run([str(argument) for argument in arguments]) == 0

    l3("lab", folder / "camera.toml", "-o", folder / "lab", "--quiet")
    l3("calibrate", folder / "lab/MEASUREMENTS.toml", "-o", folder / "camera.h5", "--quiet")
    l3("simulate", folder / "scenes.toml", "--camera", folder / "camera.h5", "-o", folder / "training.h5", "--quiet")
    l3("train", folder / "training.h5", "--classes", folder / "classes.toml", "-o", folder / "table.h5", "--quiet")
    unseen = ("--camera", folder / "camera.toml", "-o", folder / "unseen.h5", "--pictures", folder / "unseen", "--quiet")
    l3("simulate", folder / "unseen.toml", *unseen)
    raw = next((folder / "unseen").glob("*_raw.tif"))
    l3("render", folder / "table.h5", raw, "-o", folder / "picture.png")


@pytest.fixture(scope="session")
def gain_tables(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with training sets at the analog gains 1, 8 and 16, and tables. The camera states read noise up to gain 16.

    one.h5 and several.h5 are trained at gain 1, at16.h5 is trained at gain 16. several.h5 also has transforms for filtered
    frames.
    """
    return made_once("gains", make_gain_tables, tmp_path_factory)


def make_gain_tables(folder: Path) -> None:
    bayer, layer = CONFIGS / "cameras/bayer.toml", "draws = 4\n[[layer]]\nside = 3\nmosaics = 16\nrows = 500\n"
    gains = f"[gain]\ngains = [16.0]\nread_noise_e = [{load_camera(bayer).noise.read_noise}]\n"
    (folder / "camera.toml").write_text(f"{bayer.read_text()}\n{gains}")
    for gain, count in ((1, 4), (8, 1), (16, 4)):
        scene = f'[[scene]]\nsource = "dead leaves"\nsize = [96, 96]\ncount = {count}\n'
        (folder / "scenes.toml").write_text(f"exposure_share = [0.03]\n{scene}[sensor]\nanalog_gain = {gain}.0\n")
        call = ["simulate", folder / "scenes.toml", "--camera", folder / "camera.toml", "-o", folder / f"set{gain}.h5"]
        assert run([*map(str, call), "--quiet"]) == 0
    for name, gain, keys in (("one", 1, ""), ("several", 1, "noise_left = 0.1\n"), ("at16", 16, "")):
        (folder / "classes.toml").write_text(GAIN_CLASSES + keys + layer)
        call = ["train", folder / f"set{gain}.h5", "--classes", folder / "classes.toml", "-o", folder / f"{name}.h5"]
        assert run([*map(str, call), "--quiet"]) == 0
