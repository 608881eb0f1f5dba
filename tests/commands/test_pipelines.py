"""The pipelines that `l3 init` creates: make, Slurm job arrays, Snakemake and batches of videos, run as users run them."""

import contextlib
import os
import re
import shlex
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.cli import run
from l3cli.io.images import read_image
from l3cli.io.pictures.registry import write_picture
from l3cli.system.locks import sole_writer_of_file, sole_writer_of_folder
from tests.helpers.calls import L3
from tests.helpers.cameras import bayer_camera
from tests.helpers.hostile_names import Pipelines
from tests.helpers.paths import CONFIGS, ROOT
from tests.helpers.recipes import FEW_CLASSES, SMALL
from tests.helpers.workplace import PATH, Workplace, a_workplace

needs_snakemake = pytest.mark.skipif(not shutil.which("snakemake", path=PATH), reason="snakemake is not installed")
STRUCTURE = "\n[[layer]]\nside = 3\nmosaics = 8\nrows = 300\n"
TREE = "\n[[layer]]\nside = 1\nleaves = 3\ntree_rows = 1000\nmosaics = 8\nrows = 300\n"
CALL = re.compile(r"^ *l3 [a-z]+ ", re.MULTILINE)
BENCHMARK = ("camera.toml", "training.toml", "test.toml", "classes.toml", "Makefile")
MADE = ("camera.h5", "training.h5", "table.h5", "unseen.h5", "picture.png", "quality.txt", "report.html")


@pytest.fixture(scope="module")
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Workplace]:
    with a_workplace(tmp_path_factory.mktemp("bin")) as place:
        yield place


@pytest.fixture(scope="module")
def made(workplace: Workplace, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, list[str]]:
    """A folder of small recipes after `make -j`, its output and the calls of l3."""
    folder = tmp_path_factory.mktemp("pipelines") / "a camera"
    assert run(["init", "bayer", str(folder), "--quiet"]) == 0
    recipes = {
        **SMALL,
        "classes": FEW_CLASSES.replace("first_draws = 0", "draws = 2\nfirst_draws = 1").replace("levels = 4", "levels = 2"),
        "bands_scenes": SMALL["scenes"] + '[target]\noutputs = "camera"\n',
        "bands_classes": FEW_CLASSES,
        "camera": bayer_camera().replace("[400, 700, 10]", "[400, 700, 5]"),
    }
    for recipe, text in recipes.items():
        (folder / f"{recipe}.toml").write_text(text)
    return folder, *workplace.do(folder, "make -j JOBS=1")


@pytest.fixture
def folder(made: tuple[Path, str, list[str]], tmp_path: Path) -> Path:
    """A copy of the folder that make has left, times included."""
    return Path(shutil.copytree(made[0], tmp_path / "a camera"))


def test_make_leads_from_recipes_to_a_picture_and_a_report(made: tuple[Path, str, list[str]]) -> None:
    folder, out, calls = made
    assert sorted(calls) == sorted(
        ["lab virtual_lab", "calibrate camera.h5", "simulate training.h5", "simulate .unseen.h5", "train table.h5"]
        + ["render picture.png", "evaluate", "report report.html"]
    )
    assert all((folder / name).stat().st_size for name in MADE)
    assert (folder / "quality.txt").read_text() in out
    assert f"{folder}/report.html" in out
    picture, _ = read_image(folder / "picture.png")
    assert picture.shape == (96, 144, 3)
    assert {path.name.split("_")[-1] for path in (folder / "unseen").glob("[!.]*")} == {"raw.tif", "ideal.png"}


def test_a_second_make_has_nothing_to_do(workplace: Workplace, folder: Path) -> None:
    assert workplace.do(folder, "make -q picture.png quality.txt report.html")[1] == []
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    assert workplace.do(folder, "make -j")[1] == []
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before


def test_a_white_is_asked_for_once(workplace: Workplace, folder: Path) -> None:
    """Another white renders the picture again, the same white does not; no white is another."""
    for call in ("make picture.png WHITE=D50", "make picture.png"):
        assert workplace.do(folder, call)[1] == ["render picture.png"]
        assert workplace.do(folder, call)[1] == []
    out, _ = workplace.do(folder, """make -n picture.png "WHITE=D'50" """)
    rendered = next(line for line in out.splitlines() if line.startswith("l3 render"))
    assert shlex.split(rendered)[4:6] == ["--white", "D'50"]


@pytest.mark.parametrize(
    ("lights", "white"), [('"D65"', ["D65"]), ('"3200K", "A"', ["3200K"]), ('"lamp.csv"', []), ('"0.7 D65 + 0.3 A"', [])]
)
def test_unseen_frames_are_rendered_under_their_light(
    lights: str, white: list[str], workplace: Workplace, folder: Path
) -> None:
    """A named light is the white of the picture, unless another is asked for; a photo has its own."""
    (folder / "unseen.toml").write_text(f"illuminants = [{lights}] # of a lamp\n{SMALL['unseen']}")
    (folder / "photo.dng").touch()

    def whites(call: str) -> list[str]:
        words = shlex.split(workplace.do(folder, f"make -n picture.png {call}")[0])
        return [words[place + 1] for place, word in enumerate(words) if word == "--white"]

    assert whites("") == white
    assert whites("WHITE=D50") == ["D50"]
    assert whites("PHOTO=photo.dng") == []


@pytest.mark.parametrize(
    ("changed", "again"),
    [
        ("classes.toml", {"train table.h5", "render picture.png", "evaluate", "report report.html"}),
        ("unseen.toml", {"simulate .unseen.h5", "render picture.png", "evaluate", "report report.html"}),
        ("bands_scenes.toml", set()),
    ],
)
def test_only_what_depends_on_a_recipe_is_made_again(
    changed: str, again: set[str], workplace: Workplace, folder: Path
) -> None:
    (folder / changed).touch()
    out, _ = workplace.do(folder, "make -n")
    assert {call for call in again if f"l3 {call.split()[0]} " in out} == again
    assert len(CALL.findall(out)) == len(again)


def test_another_camera_makes_everything_again(workplace: Workplace, folder: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    for asked, calls in (
        ("CAMERA=camera.toml", 6),
        ("", 0),  # make -n has not taken the other camera for the one that is asked for
        ("MEASUREMENTS=virtual_lab/../virtual_lab/MEASUREMENTS.toml", 7),
    ):
        out, _ = workplace.do(folder, f"make -n {asked}")
        assert len(CALL.findall(out)) == calls, out
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before


def test_another_camera_takes_its_unseen_frames(workplace: Workplace, folder: Path) -> None:
    shutil.copy(folder / "camera.toml", folder / "other.toml")
    cameras = {"": "camera.toml", "CAMERA=other.toml": "other.toml", "MEASUREMENTS=mine.toml": "camera.h5"}
    (folder / "mine.toml").touch()
    for asked, camera in cameras.items():
        assert f"simulate unseen.toml --camera {camera} " in workplace.do(folder, f"make -n -W unseen.toml {asked}")[0], (
            asked
        )


@pytest.mark.parametrize(
    ("recipe", "named", "first"), [("bayer_bggr", "bayer.toml", "lab"), ("from_curves", "from_curves.csv", "simulate")]
)
def test_a_file_that_the_camera_is_made_of_makes_all_of_it_again(
    recipe: str, named: str, first: str, workplace: Workplace, tmp_path: Path
) -> None:
    folder = tmp_path / "folder"
    assert run(["init", recipe, str(folder), "--quiet"]) == 0
    workplace.do(folder, "make .asked .named")
    (folder / "virtual_lab").mkdir()
    for made in ("virtual_lab/MEASUREMENTS.toml", "camera.h5", "training.h5"):
        (folder / made).touch()
    assert CALL.findall(workplace.do(folder, "make -n training.h5")[0]) == []
    text = (folder / named).read_text()
    (folder / named).write_text(text.replace("450,", "451,") if named.endswith("csv") else f"{text} # mended")
    assert CALL.findall(workplace.do(folder, "make -n training.h5")[0])[0] == f"l3 {first} "


HOSTILE = ("d`touch PWNED`", "$(shell touch PWNED)", ";touch PWNED #", "a 'b\"", "a\ntouch PWNED", "100%", "-f", "字é")


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Pipelines:
    return Pipelines(tmp_path_factory.mktemp("names"))


@pytest.mark.parametrize("place", ["clip", "camera"])
@pytest.mark.parametrize("name", HOSTILE)
def test_make_runs_nothing_that_a_name_states(place: str, name: str, hostile: Pipelines) -> None:
    assert hostile.judge_name("make", place, name) is None


@pytest.mark.parametrize(
    ("pipeline", "place", "name"),
    [
        ("make", "folder", "".join(HOSTILE)),
        ("make", "curves", HOSTILE[0]),
        ("make", "curves", HOSTILE[2]),
        ("slurm", "folder", "".join(HOSTILE)),
        ("slurm", "camera", HOSTILE[1]),
        pytest.param("snakemake", "folder", "".join(HOSTILE), marks=needs_snakemake),
        pytest.param("snakemake", "camera", HOSTILE[2], marks=needs_snakemake),
    ],
)
def test_no_pipeline_runs_what_a_name_states(pipeline: str, place: str, name: str, hostile: Pipelines) -> None:
    assert hostile.judge_name(pipeline, place, name) is None


@pytest.mark.parametrize("name", ["a b.toml", "$(shell touch PWNED).toml", "-x", "100%.toml", ""])
def test_a_name_that_make_cannot_hold_is_refused(name: str, workplace: Workplace, tmp_path: Path) -> None:
    assert run(["init", "bayer", str(tmp_path / "folder"), "--quiet"]) == 0
    process = workplace.start(tmp_path / "folder", shlex.join(["make", "-n", f"CAMERA={name}"]))
    words = process.communicate()[1]
    assert "CAMERA must be the name of one file" in words
    assert "rename the file" in words
    assert (process.returncode, words.count("\n")) == (2, 1)
    assert not (tmp_path / "folder/PWNED").exists()


def test_a_stopped_make_goes_on_where_it_was(workplace: Workplace, folder: Path, tmp_path: Path) -> None:
    undisturbed = (folder / "training.h5").read_bytes()
    (folder / "training.h5").unlink()
    real = tmp_path / "l3"
    real.write_text(f'#!/bin/sh\nPYTHONPATH={ROOT} exec {sys.executable} -c "from l3cli.cli import main; main()" "$@"\n')
    real.chmod(0o755)
    process = workplace.start(folder, f"make L3={real} JOBS=1")
    parts = folder / "training.h5.parts"
    deadline = time.monotonic() + 600
    while not (parts / "000001.h5").exists() and time.monotonic() < deadline:
        time.sleep(0.005)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=600)
    assert process.returncode == -signal.SIGINT, out + err
    rest = {path: path.stat().st_mtime_ns for path in parts.iterdir()}
    assert len(rest) > 2
    assert not (folder / "training.h5").exists()

    workplace.do(folder, "make training.h5 L3=:")  # does what is done before and after l3
    assert {path: path.stat().st_mtime_ns for path in parts.iterdir()} == rest
    assert workplace.do(folder, "make training.h5 JOBS=1")[1] == ["simulate training.h5"]
    assert (folder / "training.h5").read_bytes() == undisturbed
    assert not parts.exists()

    parts.mkdir()
    (parts / "run").write_text("another run")  # of another recipe: those frames are of no use
    (parts / "000000.h5").touch()
    os.utime(folder / "scenes.toml", (time.time() + 1, time.time() + 1))
    assert workplace.do(folder, "make training.h5 JOBS=1")[1] == ["simulate training.h5"]
    assert (folder / "training.h5").read_bytes() == undisturbed
    assert not parts.exists()


def test_a_second_make_takes_nothing_from_the_first(workplace: Workplace, folder: Path) -> None:
    """While another run writes what a make is about to make, that make is refused, and nothing of the other goes."""
    for name in ("unseen.toml", "scenes.toml", "camera.toml"):
        (folder / name).touch()
    being_written = (
        "virtual_lab/dark_0.tif",
        "unseen/00000_a_raw.tif",
        "training.h5.parts/000000.h5",
        "training.h5.parts/run",
    )
    for name in being_written:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("being written")
    os.utime(folder / "training.h5.parts/run", (1, 1))
    with contextlib.ExitStack() as other:
        for name in ("virtual_lab", "unseen"):
            other.enter_context(sole_writer_of_folder(folder / name))
        other.enter_context(sole_writer_of_file(folder / "training.h5"))
        for target in ("virtual_lab/MEASUREMENTS.toml", "unseen.h5", "training.h5"):
            before = {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file() and path.name[0] != "."}
            process = workplace.start(folder, f"make {target} -o camera.h5 JOBS=1")
            out, err = process.communicate(timeout=600)
            assert process.returncode == 2, out + err
            assert err.count("is being written by another run") == 1, err
            after = {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file() and path.name[0] != "."}
            assert after == before


def test_make_leaves_no_picture_of_an_earlier_recipe(workplace: Workplace, folder: Path) -> None:
    (folder / "unseen/00000_earlier_raw.tif").write_text("of an earlier recipe")
    (folder / "unseen.toml").write_text(SMALL["unseen"].replace("seed = 5", "seed = 6"))
    _, calls = workplace.do(folder, "make picture.png -o training.h5 -o table.h5 JOBS=1")
    assert calls == ["simulate .unseen.h5", "render picture.png"]
    assert sorted(path.name for path in (folder / "unseen").glob("[!.]*")) == [
        "00000_composition-6-0_ideal.png", "00000_composition-6-0_raw.tif",
    ]  # fmt: skip
    assert not list(folder.glob(".unseen*"))


def test_make_bands_gives_every_band_of_the_camera(workplace: Workplace, folder: Path) -> None:
    _, calls = workplace.do(folder, "make bands JOBS=1")
    assert calls == ["simulate bands_training.h5", "train bands.h5", "render bands.exr"]
    assert load(TransformTable, folder / "bands.h5").outputs == ("r", "g", "b")
    assert read_image(folder / "bands.exr")[0].shape == (96, 144, 3)
    assert workplace.do(folder, "make bands")[1] == []


def test_make_clean_leaves_the_recipes_and_what_is_the_users(workplace: Workplace, folder: Path) -> None:
    (folder / "lab").mkdir()
    (folder / "lab/mine.tif").touch()
    (folder / "mine.h5").touch()
    workplace.do(folder, "make clean")
    left = {path.name for path in folder.iterdir()}
    assert {"lab", "mine.h5", "camera.toml", "Makefile"} <= left
    assert not left & {*MADE, "virtual_lab", "unseen", ".asked"}


def test_a_benchmark_learns_from_pictures_and_judges_on_others(workplace: Workplace, tmp_path: Path, l3: L3) -> None:
    folder = tmp_path / "benchmark"
    code, _, err = l3("init", "benchmark-bayer", folder)
    assert code == 0
    assert "2×2, 3 channels   A Bayer array, GRBG" in err
    assert {path.name for path in folder.iterdir()} == set(BENCHMARK)
    for name in BENCHMARK:
        assert (folder / name).read_bytes() == (CONFIGS / "benchmarks/bayer" / name).read_bytes()

    make = "make JOBS=1 BORDER=4"
    refused = workplace.start(folder, make)
    assert "the folder training is missing; make it and put RGB pictures into it" in refused.communicate(timeout=600)[1]
    for seed, name in enumerate(("training", "test")):
        (folder / name).mkdir()
        noise = np.random.default_rng(seed).random((3, 64, 80))
        smooth = gaussian_filter(noise.mean(axis=0), 1.2) + 0.2 * gaussian_filter(noise, (0, 4, 4))
        codes = np.rint(255 * (smooth - smooth.min()) / np.ptp(smooth)).astype(np.uint8)
        write_picture(folder / name / "noise.png", np.ascontiguousarray(np.moveaxis(codes, 0, -1)))
    (folder / "classes.toml").write_text(FEW_CLASSES)
    out, calls = workplace.do(folder, make)
    assert sorted(calls) == ["evaluate", "simulate test.h5", "simulate training.h5", "train table.h5"]
    assert out.endswith((folder / "quality.txt").read_text())
    assert "bilinear" in out
    assert workplace.do(folder, make)[1] == []


def test_a_batch_of_clips_becomes_videos(workplace: Workplace, folder: Path) -> None:
    av = pytest.importorskip("av")
    assert "clips/" in workplace.do(folder, "make video")[0]
    frame = next((folder / "unseen").glob("*_raw.tif"))
    mosaic = read_image(frame)[0][..., 0]
    clip = folder / "clips/street"
    clip.mkdir(parents=True)
    for number in range(3):
        shutil.copy(frame, clip / f"{number:04d}.tif")
    np.save(folder / "clips/night.npy", np.stack([mosaic // 2] * 4))
    (folder / "clips/broken.npy").write_bytes(b"no frames")
    command = 'make video "VIDEO=--fps 25"'
    assert workplace.do(folder, command, code=2)[1] == ["render videos"]
    (folder / "clips/broken.npy").unlink()
    assert workplace.do(folder, command)[1] == ["render videos"]
    for name, frames in (("street", 3), ("night", 4)):
        with av.open(str(folder / f"videos/{name}.mp4")) as video:
            assert video.streams.video[0].average_rate == 25
            assert sum(1 for _ in video.decode(video=0)) == frames


def test_a_slurm_cluster_learns_layers_in_arrays(workplace: Workplace, three_layers: Path) -> None:
    folder, classes = three_layers, (three_layers / "classes.toml").read_text()
    (folder / "classes.toml").write_text(f"{classes.replace('patch = 5', 'patch = 4')}")
    out, calls = workplace.do(folder, "./slurm.sh 2")
    steps = ["camera", "simulate", "first", "merge-first", "second", "merge-second", "layer2", "merge-layer2", "layer3"]
    steps.append("finish")
    assert out.splitlines() == [f"{step}: job {101 + index}" for index, step in enumerate(steps)]
    passes = ("first", "second", "layer2", "layer3")
    arrays = {step: [f"{step}_000{task}.h5" for task in (1, 2)] for step in ("training", *passes)}
    assert [call.split("/")[-1] for call in calls] == [*arrays["training"], *arrays["first"]]
    assert "patch" in (folder / "slurm/2/log/l3-first-103-1.txt").read_text()

    (folder / "classes.toml").write_text(classes)
    _, calls = workplace.do(folder, "./slurm.sh 2")
    learned = [call for step in passes for call in (*arrays[step], f"{step}.h5")][:-1]
    finished = ["table.h5", "picture.png", "report.html", "evaluate"]
    assert [call.split("/")[-1] for call in calls] == [*learned, *finished]
    assert "ΔE00" in (folder / "slurm/2/log/l3-finish-120-0.txt").read_text()
    sets = sorted((folder / "slurm/2").glob("training_*.h5"))
    assert sets[0].read_bytes() != sets[1].read_bytes()
    require_three_layers(folder, "slurm/2/table.h5", *map(str, sets))


@pytest.fixture
def three_layers(folder: Path) -> Path:
    """The folder with a class recipe of three layers."""
    with (folder / "classes.toml").open("a") as classes:
        classes.write(STRUCTURE + TREE)
    return folder


def require_three_layers(folder: Path, made: str, *sets: str) -> None:
    """The table `made` has all layers of the recipe, and the bytes of one that is trained in one go."""
    with contextlib.chdir(folder):
        assert run(["train", *sets, "--classes", "classes.toml", "-o", "whole.h5", "--jobs", "1", "--quiet"]) == 0
    assert (folder / made).read_bytes() == (folder / "whole.h5").read_bytes()
    assert [layer.side for layer in load(TransformTable, folder / made).later] == [3, 1]


@pytest.mark.parametrize("call", ["./slurm.sh", "./slurm.sh many", "./slurm.sh simulat 2"])
def test_a_wrong_call_of_the_slurm_script_is_refused(call: str, workplace: Workplace, folder: Path) -> None:
    process = workplace.start(folder, call)
    assert process.communicate()[1].count("\n") == 1
    assert process.returncode in (1, 2)


SNAKEMAKE = "snakemake --cores 2 --config shards=2 camera=camera.toml"
RULES = {
    "classes": 1,
    "simulate": 2,
    "learn": 4,
    "merge": 1,
    "table": 1,
    "unseen": 1,
    "picture": 1,
    "quality": 1,
    "report": 1,
}


def planned(workplace: Workplace, folder: Path) -> dict[str, int]:
    """How often Snakemake would run each rule."""
    out, calls = workplace.do(folder, f"{SNAKEMAKE} --dry-run --quiet rules")
    assert calls == []
    pairs = (line.split() for line in out.splitlines() if len(line.split()) == 2)
    return {rule: int(times) for rule, times in pairs if times.isdecimal()}


@needs_snakemake
def test_snakemake_plans_what_depends_on_what(workplace: Workplace, folder: Path) -> None:
    assert planned(workplace, folder) == RULES | {"all": 1, "total": sum(RULES.values()) + 1}


@needs_snakemake
def test_snakemake_learns_further_layers(workplace: Workplace, three_layers: Path) -> None:
    _, calls = workplace.do(three_layers, "snakemake snakemake/table.h5 --cores 1 --config shards=1 camera=camera.toml")
    learned = ["first_1.h5", "first.h5", "second_1.h5", "second.h5", "layer2_1.h5", "layer2.h5", "layer3_1.h5", "table.h5"]
    assert [call.split("/")[-1] for call in calls][1:] == learned
    require_three_layers(three_layers, "snakemake/table.h5", "snakemake/training_1.h5")


@needs_snakemake
@pytest.mark.slow
def test_snakemake_learns_in_shards(workplace: Workplace, folder: Path) -> None:
    _, calls = workplace.do(folder, SNAKEMAKE)
    assert len(calls) == sum(RULES.values()) - RULES["classes"]
    made = folder / "snakemake"
    assert all((made / name).stat().st_size for name in ("table.h5", "picture.png", "quality.txt", "report.html"))
    whole = folder / "whole.h5"
    sets = [str(made / f"training_{shard}.h5") for shard in (1, 2)]
    assert run(["train", *sets, "--classes", str(folder / "classes.toml"), "-o", str(whole), "--quiet"]) == 0
    assert (made / "table.h5").read_bytes() == whole.read_bytes()
    assert workplace.do(folder, SNAKEMAKE)[1] == []
    (folder / "unseen.toml").touch()
    (folder / "unseen.toml").write_text(SMALL["unseen"].replace("seed = 5", "seed = 6"))
    assert workplace.do(folder, SNAKEMAKE)[1][0] == "simulate snakemake/unseen.h5"
