"""The commands, Python code and TOML text on the pages of docs/ and in the README are run.

Every block of a page runs in its own folder, which contains the files that the block names. NOT_HERE gives the reason for
each command that cannot be run in a test.
"""

import os
import re
import shutil
import subprocess
import tomllib
from itertools import product
from pathlib import Path

import h5py
import msgspec
import numpy as np
import pytest
import tifffile

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import ChannelRecipe, load_camera
from l3cli.artifacts.store import load
from l3cli.artifacts.training_set import open_training_set
from l3cli.cli import run
from l3cli.design import error
from l3cli.io.measurement_recipe import CaptureRecipe, CorrectionRecipe, MeasurementRecipe
from l3cli.io.pictures.openimageio import write_mosaic
from l3cli.recipes import builtin
from l3cli.recipes.load import load_recipe
from l3cli.recipes.toml import Recipe
from l3cli.simulation.recipe import SceneRecipe
from l3cli.simulation.sensor import expose
from tests.helpers.calls import L3
from tests.helpers.cameras import bayer_camera
from tests.helpers.dng_files import write_dng
from tests.helpers.paths import CONFIGS, ROOT
from tests.helpers.photos import chart_mosaic
from tests.helpers.readme import PAGES, README, blocks, commands, fenced, sessions
from tests.helpers.recipes import FEW_CLASSES, SMALL
from tests.helpers.sequences import write_raw_video

CLASSES = "[classes]\npatch = 5\nlevels = 4\nchromas = 1\n[learning]\npatches = 300\n"  # in two passes, as default

NOT_RUN = {
    "--photo chart.dng": "a photo of a chart: tests/commands/test_calibrate_photo.py, test_webcam.py",
    "shading.toml": "tests/commands/test_webcam.py",
    "--show dolp --camera": "a measured polarisation camera: tests/science/test_pixel_polarisers.py",
    "camera.h5 -o tuning": "tests/commands/test_webcam.py",
    "--draft captures": "tests/commands/test_draft.py",
    "l3 report": "tests/commands/test_report.py",
    "clip/*.dng": "five hundred frames: tests/commands/test_sequences.py",
    "--scheduler": "a cluster: tests/commands/test_cluster.py",
    "grab |": "a camera at work: tests/commands/test_render_io.py",
    "monday/*.mkv": "clips of a day: tests/commands/test_many_clips.py",
    "incoming/": "clips that arrive: tests/commands/test_many_clips.py",
    "simulate motion": "two hundred frames: tests/commands/test_clips.py",
    "composition-": "clips with their truth: tests/commands/test_clips.py, test_sequence_evaluation.py",
    "lab fiveband": "the worked example: tests/commands/test_readme.py",
}
GEOMETRY = """name = "a camera"
sensor = { rows = 192, cols = 256, pixel_pitch_um = 4.0, bits = 12 }
cfa = { channels = ["r", "g", "b"], pattern = ["r g", "g b"] }
optics = { focal_length_mm = 25, f_number = 2.8 }
"""  # what a measurement file begins with
PLUGINS = "python.md"  # whose package tests/commands/test_plugins.py installs
PROSE = {name: text for name, text in {"README.md": README, **PAGES}.items() if name not in ("method.md", "architecture.md")}


BLOCKS = [(name, block) for name, text in PROSE.items() for block in blocks(text)]
SHELL = {block: name for name, block in BLOCKS if re.search(r"^l3 ", block, re.MULTILINE)}  # what two pages show is run once
PYTHON = [(name, block) for name, block in BLOCKS if block.startswith("import l3cli")]
TABLES = [(name, block) for name, block in BLOCKS if name != PLUGINS and re.match(r"(\w+ = .*\n)*\[\[?\w+\]", block)]


@pytest.fixture(scope="module")
def desk(pipeline: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with every file that the pages name, of a small Bayer camera; configs/ are recipes as small."""
    folder = tmp_path_factory.mktemp("desk")
    shutil.copytree(pipeline / "lab", folder, dirs_exist_ok=True)  # MEASUREMENTS.toml and its frames
    shutil.copytree(pipeline / "lab", folder / "lab")
    shutil.copytree(pipeline / "lab", folder / "captures", ignore=shutil.ignore_patterns("MEASUREMENTS.toml"))
    for name in ("camera", "training", "table", "unseen"):
        shutil.copy(pipeline / f"{name}.h5", folder)
    for name in ("faces", "pictures", "leaves"):
        shutil.copy(pipeline / "training.h5", folder / f"{name}.h5")
    shutil.copytree(CONFIGS, folder / "configs")
    small = {"cameras/bayer": bayer_camera(), "classes/default": CLASSES}
    small["scenes/default"] = 'illuminants = ["D65"]\n' + SMALL["scenes"]
    small["classes/fast"] = small["classes/polarised"] = FEW_CLASSES
    small["designs/dyes"] = re.sub(r"^[ocyk] = .*\n", "", (CONFIGS / "designs/dyes.toml").read_text(), flags=re.MULTILINE)
    small["scenes/demo_unseen"] = (CONFIGS / "scenes/demo_unseen.toml").read_text().replace("[720, 1280]", "[192, 256]")
    for name in ("polarised", "polarised_unseen"):
        text = (
            (CONFIGS / f"scenes/{name}.toml")
            .read_text()
            .replace("count = 60", "count = 3")
            .replace("count = 6", "count = 1")
        )
        small[f"scenes/{name}"] = text.replace("[720, 1280]", "[96, 128]")
    for name, text in small.items():
        (folder / "configs" / f"{name}.toml").write_text(text)
    (folder / "SCENES.toml").write_text(SMALL["scenes"])
    (folder / "CLASSES.toml").write_text(CLASSES)
    chart = chart_mosaic(load_camera(folder / "configs/cameras/bayer.toml"), "A")
    raw_files(folder, tifffile.imread(next((pipeline / "unseen").glob("*_raw.tif"))), chart)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(builtin, "recipe_folder", lambda: folder / "configs")
        assert run(["init", "--from", str(folder / "photo.dng"), str(folder / "mine"), "--quiet"]) == 0
        frames, table = str(folder / "polarised_training.h5"), str(folder / "polarised.h5")
        assert run(["simulate", "polarised", "--camera", "polarised", "-o", frames, "--quiet"]) == 0
        assert run(["train", frames, "-o", table, "--quiet"]) == 0
    return folder


def raw_files(folder: Path, mosaic: np.ndarray, chart: np.ndarray) -> None:
    """Raw frames in all formats that the pages name."""
    from astropy.io import fits

    rggb = np.array([[0, 1], [1, 2]])
    large = np.tile(mosaic, (7, 4))[:960, :864]  # of no more pixels than a grey's place on a page needs
    large[900:960, 800:850] = 2000  # the grey
    large[100 : 100 + chart.shape[0], 100 : 100 + chart.shape[1]] = chart
    parts = (9000, -2000, -800, -4000, 12000, 2000, -500, 1500, 6000)
    matrix = [number for part in parts for number in (part, 10000)]
    colour = {50721: (10, matrix), 50778: (3, [21]), 50728: (5, [60, 100, 100, 100, 70, 100]), 33434: (5, [1, 100])}
    write_dng(folder / "large.dng", large, rggb, tags=colour)
    write_dng(folder / "frame.dng", np.tile(mosaic, (2, 2))[:192, :256], rggb, tags=colour)
    for name in ("photo.dng", "other.dng"):
        write_dng(folder / name, mosaic, rggb, tags=colour)
    (folder / "dump.raw10").write_bytes(bytes(1080 * 2432))
    (folder / "grab.raw").write_bytes(bytes(512 + 1080 * 1920 * 3 // 2))
    (folder / "darks").mkdir()
    for name, values in {"night.fits": mosaic, "darks/1.fits": np.full_like(mosaic, 64)}.items():
        fits.writeto(folder / name, values, fits.Header({"EXPTIME": 1.0, "BAYERPAT": "RGGB"}))
    tifffile.imwrite(folder / "polarised.tif", mosaic)
    (folder / "clip").mkdir()
    for number in range(3):
        tifffile.imwrite(folder / f"clip/frame_{number:04}.tif", mosaic)
    write_raw_video(folder / "mosaic.mkv")
    with h5py.File(folder / "stack.h5", "w") as stack:
        stack["take1/raw"] = np.stack([mosaic, mosaic])


@pytest.mark.parametrize(("block", "name"), SHELL.items(), ids=lambda value: value.split("\n")[0][:40])
def test_the_commands_of_a_block_run(
    name: str, block: str, desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, l3: L3
) -> None:
    monkeypatch.setattr(builtin, "recipe_folder", lambda: desk / "configs")
    monkeypatch.setattr(error, "KEPT_POWER", 0.99)  # fewer principal spectra, so that files of scene moments are smaller
    shutil.copytree(desk, tmp_path, copy_function=os.link, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    if "--white" in block:
        (tmp_path / "large.dng").replace("frame.dng")  # of as many pixels as a grey's place needs
    for line in block.splitlines():
        if not re.match("l3 |make ", line) or any(word in line for word in NOT_RUN):
            continue
        for words in commands(line):
            prepare(words, tmp_path)
            code, _, err = l3(*words, *(["--quiet"] if words[0] not in ("info", "init", "schema", "check") else []))
            assert code == 0, f"{name}: l3 {' '.join(words)}: {err}"
        for folder in re.findall(r"make -C (\w+)", line):
            subprocess.run(["make", "-n", "-C", folder], check=True, capture_output=True)


def prepare(words: list[str], folder: Path) -> None:
    """Clear the way for a command: its outputs are not there yet, the inputs that earlier pages leave are."""
    outputs = [words[at + 1] for at, word in enumerate(words) if word == "-o"]
    if words[0] == "init" and len(words) > 1:
        outputs.append(words[-1])
    for output in outputs:
        path = folder / output
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    if "mine/table.h5" in words and not (folder / "mine/table.h5").exists():
        os.link(folder / "table.h5", folder / "mine/table.h5")


@pytest.mark.parametrize(("name", "block"), PYTHON, ids=[name for name, _ in PYTHON])
def test_the_python_of_a_page_runs(
    name: str, block: str, desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(builtin, "recipe_folder", lambda: desk / "configs")
    for each in ("lab", "frame.dng"):
        (tmp_path / each).symlink_to(desk / each)
    monkeypatch.chdir(tmp_path)
    names: dict[str, np.ndarray] = {}
    exec(block.replace("jobs=2", "jobs=1"), names)
    assert (names["picture"].shape, names["picture"].dtype) == ((192, 256, 3), np.uint8)


@pytest.mark.parametrize(("name", "block"), TABLES, ids=[f"{name}-{at}" for at, (name, _) in enumerate(TABLES)])
def test_the_keys_of_a_page_are_keys(name: str, block: str, tmp_path: Path) -> None:
    block = re.sub(r"^l3 .*", "", block, flags=re.MULTILINE)
    content = tomllib.loads(block)
    if channels := content.get("channel"):
        msgspec.convert(channels, dict[str, ChannelRecipe])
        return
    if "target" in content and "scene" not in content:
        block += '\n[[scene]]\nsource = "dead leaves"\nsize = [32, 32]\n'
        block = f"exposure_share = [0.5]\n{block}"
    kind: type[Recipe] = CorrectionRecipe if "base" in content else MeasurementRecipe
    if {"pair", "target", "scene"} & content.keys():
        kind = SceneRecipe
    head = GEOMETRY if kind is MeasurementRecipe else ""
    (tmp_path / "a.toml").write_text(head + block)
    load_recipe(tmp_path / "a.toml", kind)


def test_the_example_finds_where_a_jpeg_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cv2 = pytest.importorskip("cv2")
    monkeypatch.chdir(tmp_path)
    picture = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 256, (200, 260, 3), np.uint8), (0, 0), 2)
    cv2.imwrite("picture.png", picture)
    cv2.imwrite("photo.jpg", cv2.convertScaleAbs(picture[6:191, 10:250], alpha=1.2, beta=9))
    (script,) = (block for name, block in BLOCKS if name == "raw-files.md" and block.startswith("import cv2"))
    exec(script, {})
    assert capsys.readouterr().out == 9 * "6 10\n"


def test_the_example_removes_the_headers_of_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    clip = np.random.default_rng(0).integers(0, 4096, (2, 1080, 1920), np.uint16)
    parts = [bytes(512), *(bytes(64) + frame.astype("<u2").tobytes() for frame in clip)]
    Path("clip.raw").write_bytes(b"".join(parts))
    (script,) = fenced(PAGES["raw-files.md"], "python")
    exec(script, {})
    np.testing.assert_array_equal(np.load("clip.npy"), clip)


def test_the_example_of_spectral_scenes_prints_what_is_shown(
    l3: L3, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    page = PAGES["spectral-scenes.md"]
    (script,) = fenced(page, "python")
    exec(script, {})
    recipe = next(block for name, block in TABLES if name == "spectral-scenes.md")
    for ((line, shown),), white, code in zip(sessions(page), ("", "white = 10000\n"), (3, 0), strict=True):
        (tmp_path / "SCENES.toml").write_text(f"{recipe}\n{white}")
        got, out, err = l3(*commands(line)[0])
        assert (got, (out + err).splitlines()) == (code, shown)


def test_the_example_of_polarised_pictures_prints_what_is_shown(
    l3: L3, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    page = PAGES["polarisation.md"]
    (script,) = fenced(page, "python")
    exec(script, {})
    recipe = next(block for name, block in TABLES if name == "polarisation.md" and "[target]" in block)
    (tmp_path / "SCENES.toml").write_text(recipe)
    (((line, shown),),) = sessions(page)
    code, out, err = l3(*commands(line)[0])
    assert (code, (out + err).splitlines()) == (0, shown)
    with open_training_set(tmp_path / "training.h5") as reader:
        frame = reader.frame(0)
    seen = frame.target[:, 16, 24] / frame.white[1]
    np.testing.assert_allclose(seen, [0.1, 0.4, 0.173], atol=1e-3)  # S1, S0, S2


def test_the_example_of_a_method_of_your_own_compares_it(
    desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("table.h5", "unseen.h5"):
        (tmp_path / name).symlink_to(desk / name)
    (script,) = (text for text in fenced(PAGES["python.md"], "python") if "rivals=" in text)
    exec(script, {})
    mine, ours = map(float, capsys.readouterr().out.split())
    assert mine == pytest.approx(ours, rel=0.1)  # the method of the example is the table; l3 fits the brightness of mine


def test_the_example_of_test_vectors_renders_them(
    desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, l3: L3
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "table.h5").symlink_to(desk / "table.h5")
    assert l3("export", "table.h5", "-o", "source", "--quiet")[0] == 0
    (script,) = (text for text in fenced(PAGES["export.md"], "python") if "test_raw.bin" in text)
    exec(script, {})
    labels, expected = (np.fromfile(path, "<u4") for path in ("labels.bin", "source/test_labels.bin"))
    np.testing.assert_array_equal(labels, expected[: labels.size])
    outputs, expected = (np.fromfile(path, "<f4") for path in ("outputs.bin", "source/test_outputs.bin"))
    np.testing.assert_array_equal(outputs, expected)


def test_the_session_of_check_prints_what_is_shown(l3: L3, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    (session,) = [block for name, block in BLOCKS if name == "commands.md" and "$ l3 check" in block]
    printed = [" ".join(line.split()) for line in l3("check", "from_curves")[1].replace(f"{ROOT}/", "").splitlines()]
    for line in session.partition("$ l3 ")[2].splitlines()[1:]:
        assert line.strip() == "…" or " ".join(line.split()) in printed, line


def test_the_session_of_verify_prints_what_is_shown(desk: Path, l3: L3, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(desk)
    (session,) = [block for name, block in BLOCKS if name == "artifacts.md" and "$ l3 info" in block]
    given = [
        "table.h5",
        "training.h5",
        "camera.h5",
        "lab/MEASUREMENTS.toml",
        *map(str, sorted(Path("lab/mono").glob("*.tif"))),
    ]
    code, out, _ = l3("info", "--verify", *given)
    printed = [re.sub(r"\d+", "#", line) for line in out.splitlines()]
    assert code == 0
    for line in session.partition("$ l3 ")[2].splitlines()[1:]:
        assert line.strip() == "…" or re.sub(r"\d+", "#", line) in printed, line


EXAMPLES = blocks(PAGES["own-lab.md"])
HEAD = next(block for block in EXAMPLES if block.startswith("name = "))
PARTS = {match[1]: block for block in EXAMPLES if (match := re.match(r"\[\[?(\w+)\]", block))}
FILES = {match[1]: block for block in EXAMPLES if (match := re.match(r"# (\S+\.csv)", block))}


def take_frames(folder: Path, recipe: MeasurementRecipe, camera: CameraModel) -> None:
    """What a camera gives of the white and dark frames that a measurement file names."""
    captures: list[tuple[CaptureRecipe, float]] = [(white, 1.2e6) for white in recipe.white]  # e-/s
    captures += [(dark, 0.0) for dark in recipe.dark]
    for number, (capture, rate) in enumerate(captures):
        assert capture.seconds is not None
        for trial, name in enumerate(capture.frames):
            electrons = np.full((camera.rows, camera.cols), rate * capture.seconds)
            rng = np.random.default_rng([number, trial])
            write_mosaic(folder / name, expose(camera, electrons, capture.seconds, rng))


@pytest.mark.parametrize(("source", "sensor"), [*product(["sweep", "curves"], ["white", "datasheet"])])
def test_the_examples_make_a_camera(source: str, sensor: str, bayer_recipe: Path, tmp_path: Path, l3: L3) -> None:
    file, camera = tmp_path / "MEASUREMENTS.toml", load_camera(bayer_recipe)
    stated = PARTS["uncertainty"] if source == "sweep" else re.sub("photodiode.*", "", PARTS["uncertainty"])
    file.write_text("\n\n".join([HEAD, PARTS[source], PARTS[sensor], stated]))
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    recipe = load_recipe(file, MeasurementRecipe)
    assert msgspec.to_builtins(recipe)[source]
    take_frames(tmp_path, recipe, camera)
    assert l3("check", file)[0] == 0
    code, _, err = l3("calibrate", file, "-o", tmp_path / "camera.h5", "--quiet")
    assert (code, err) == (0, "")
    made = load(CameraModel, tmp_path / "camera.h5")
    assert made.wavelength[made.responsivity.argmax(axis=1)].tolist() in ([600, 550, 450], [600, 500, 450])
    if sensor == "white":
        assert made.gain == pytest.approx(camera.gain, rel=0.05)
        assert made.noise.read_noise == pytest.approx(camera.noise.read_noise, rel=0.1)
