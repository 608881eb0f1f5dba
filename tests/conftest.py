"""Fixtures are the stages before: camera → training set → table. All are small, all are made by the real commands."""

import contextlib
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.cli import run

CONFIGS = Path(__file__).parents[1] / "configs"
TERMINAL = ("TERM", "COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR")  # what tests of terminals say themselves


@pytest.fixture(scope="session")
def fiveband() -> CameraModel:
    """The five-band camera of its recipe."""
    return load_camera(CONFIGS / "cameras/fiveband.toml")


@pytest.fixture
def l3(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Run `l3 ARGUMENTS`: exit code, stdout, stderr."""

    def call(*arguments: object) -> tuple[int, str, str]:
        capsys.readouterr()
        code = run([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


@pytest.fixture
def refused(l3: Callable[..., tuple[int, str, str]], tmp_path: Path) -> Callable[..., str]:
    """Run `l3 ARGUMENTS` that must fail with `code`: one line on stderr, no new file below tmp_path. Returns the line."""

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
def l3_data() -> Path:
    """The folder of real data; the test is skipped where it is absent."""
    folder = Path(os.environ.get("L3_DATA", ""))
    if not os.environ.get("L3_DATA") or not folder.is_dir():
        pytest.skip("L3_DATA does not name the folder of real data")
    return folder


def bayer_camera(bits: int = 12, pattern: tuple[str, ...] = ("r g", "g b")) -> str:
    """The text of a small Bayer camera recipe."""
    rows = ", ".join(f'"{row}"' for row in pattern)
    return f"""
name = "small Bayer"
[sensor]
rows = 192
cols = 256
pixel_pitch_um = 4.0
bits = {bits}
gain_dn_per_e = {0.25 * 2.0 ** (bits - 12)}
black_dn = {64 * 2 ** (bits - 12)}
fixed_pattern_seed = 3
[cfa]
channels = ["r", "g", "b"]
pattern = [{rows}]
[responsivity]
wavelength_nm = [400, 700, 10]
peak_efficiency = 0.4
[responsivity.gaussians]
r = [{{ peak = 0.8, centre_nm = 600, sigma_nm = 35 }}]
g = [{{ peak = 1.0, centre_nm = 535, sigma_nm = 40 }}]
b = [{{ peak = 0.9, centre_nm = 460, sigma_nm = 30 }}]
[noise]
read_noise_e = 4.0
dark_current_e_per_s = 5.0
dsnu_e = 2.0
prnu = 0.005
well_capacity_e = 15000
[optics]
focal_length_mm = 25
f_number = 2.8
"""


@pytest.fixture(scope="session")
def bayer_recipe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("camera") / "bayer.toml"
    path.write_text(bayer_camera())
    return path


@pytest.fixture(scope="session")
def bayer(bayer_recipe: Path) -> CameraModel:
    """A small Bayer camera."""
    return load_camera(bayer_recipe)


def random_case_of_code(channels: int, rng: np.random.Generator) -> np.ndarray:
    """A saturation-case map with a few cases, code 0 being case 0."""
    cases = rng.integers(0, 4, 2**channels).astype(np.uint16)
    cases[0] = 0
    return cases


@pytest.fixture(scope="session")
def fine_bayer_recipe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small Bayer camera with curves every 5 nm, as calibration gives them: no kinks between its nodes."""
    path = tmp_path_factory.mktemp("camera") / "bayer.toml"
    text = bayer_camera()
    assert "[400, 700, 10]" in text
    path.write_text(text.replace("[400, 700, 10]", "[400, 700, 5]"))
    return path


@pytest.fixture(scope="session")
def lab_folder(fine_bayer_recipe: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the virtual lab measures of the small Bayer camera, a camera whose well saturates before its converter."""
    path = tmp_path_factory.mktemp("lab")
    assert run(["lab", str(fine_bayer_recipe), "-o", str(path), "--quiet"]) == 0
    return path


SCENES = """
exposure_share = [0.9]
[[scene]]
source = "dead leaves"
size = [96, 96]
count = 10
"""
UNSEEN = """
exposure_share = [0.8]
[[scene]]
source = "composition"
size = [160, 240]
seed = 5
"""
CLASSES = "[classes]\npatch = 5\nlevels = 8\n[learning]\npatches = 12000\n"


@pytest.fixture(scope="session")
def pipeline(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which every command has run, from camera.toml and lab/ to table.h5 and picture.png."""
    folder = tmp_path_factory.mktemp("pipeline")
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
    return folder


def in_terminal(command: list[str], environment: dict[str, str], columns: int = 80) -> str:
    """What a command shows on a terminal of 24 rows, stdout and stderr together."""
    import fcntl
    import pty
    import struct
    import subprocess
    import termios

    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    known = {"TERM": "xterm-256color", **{key: value for key, value in os.environ.items() if key not in TERMINAL}}
    known |= {"PYTHONPATH": str(CONFIGS.parent), **environment}
    run = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=theirs, stderr=theirs, env=known)
    os.close(theirs)
    shown = b""
    with contextlib.suppress(OSError):  # what reading says when the other end is closed
        while part := os.read(ours, 65536):
            shown += part
    os.close(ours)
    assert run.wait(timeout=60) == 0, shown
    return shown.decode()
