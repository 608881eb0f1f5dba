"""The pipelines that l3 init lays down, run as users run them: make, Slurm's job arrays, Snakemake, a batch of videos.

Their `l3` is a client of this process, which works its calls off one after the other: real work, only Python is not started
anew for each. Slurm is a program that runs the tasks of a job when it is submitted.
"""

import contextlib
import io
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Iterator
from multiprocessing.connection import Client, Listener
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.cli import run
from l3cli.io.images import read_image
from l3cli.locks import sole_writer_of_file, sole_writer_of_folder
from tests.helpers.cameras import bayer_camera
from tests.helpers.paths import ROOT
from tests.helpers.recipes import SMALL

PATH = f"{Path(sys.executable).parent}:{os.environ['PATH']}"  # programs of the environment that runs the tests
CLIENT = """#!{python} -IS
import os, sys
from multiprocessing.connection import Client
with Client({address!r}) as server:
    server.send((os.getcwd(), sys.argv[1:]))
    code, out, err = server.recv()
sys.stdout.write(out)
sys.stderr.write(err)
sys.exit(code)
"""
SBATCH = """#!{python} -IS
import argparse, os, pathlib, subprocess
parser = argparse.ArgumentParser()
for name in ("job-name", "output", "array", "dependency", "kill-on-invalid-dep"):
    parser.add_argument("--" + name)
parser.add_argument("--parsable", action="store_true", required=True)
parser.add_argument("script", type=pathlib.Path)
parser.add_argument("arguments", nargs=argparse.REMAINDER)
asked = parser.parse_args()
jobs = pathlib.Path({jobs!r})
job = str(101 + len(list(jobs.iterdir())))
kind, _, before = (asked.dependency or "").partition(":")
assert kind in ("", "afterok"), kind
state = (jobs / before / "state").read_text() if before else "done"
(jobs / job).mkdir()
script = jobs / job / "slurm_script"
script.write_bytes(asked.script.read_bytes())  # Slurm runs a copy from its spool
script.chmod(0o755)
first, _, last = (asked.array or "0").partition("-")
for task in range(int(first), int(last or first) + 1) if state == "done" else ():
    variables = dict(SLURM_JOB_ID=job, SLURM_CPUS_PER_TASK="1")
    variables |= dict(SLURM_ARRAY_TASK_ID=str(task)) if asked.array else dict()
    log = asked.output.replace("%x", asked.job_name).replace("%A", job).replace("%a", str(task))
    with open(log, "w") as written:
        done = subprocess.run([script, *asked.arguments], env=os.environ | variables, stdout=written, stderr=written)
    state = state if done.returncode == 0 else "failed"
(jobs / job / "state").write_text(state)
print(job)
"""
needs_snakemake = pytest.mark.skipif(not shutil.which("snakemake", path=PATH), reason="snakemake is not installed")
STRUCTURE = "\n[[layer]]\nside = 3\nmosaics = 8\nrows = 300\n"
TREE = "\n[[layer]]\nside = 1\nleaves = 3\ntree_rows = 1000\nmosaics = 8\nrows = 300\n"
CALL = re.compile(r"^ *l3 [a-z]+ ", re.MULTILINE)
MADE = ("camera.h5", "training.h5", "table.h5", "unseen.h5", "picture.png", "quality.txt", "report.html")


class Workplace:
    """A PATH whose `l3` and `sbatch` work here, and what `l3` has been asked."""

    def __init__(self, folder: Path, address: str) -> None:
        self.calls: list[str] = []  # in order: command and output
        self.bin = folder
        (folder / "jobs").mkdir()
        for name, text in {"l3": CLIENT, "sbatch": SBATCH}.items():
            (folder / name).write_text(text.format(python=sys.executable, address=address, jobs=str(folder / "jobs")))
            (folder / name).chmod(0o755)

    def serve(self, listener: Listener) -> None:
        """Work off calls until one comes without arguments."""
        while True:
            with listener.accept() as caller:
                folder, arguments = caller.recv()
                if not arguments:
                    return
                out, err = io.StringIO(), io.StringIO()
                with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                    try:
                        code = run(arguments)
                    except Exception:
                        traceback.print_exc()
                        code = 1
                self.calls.append(
                    f"{arguments[0]} {arguments[arguments.index('-o') + 1] if '-o' in arguments else ''}".strip()
                )
                caller.send((code, out.getvalue(), err.getvalue()))

    def start(self, folder: Path, command: str) -> subprocess.Popen:
        environment = os.environ | {"PATH": f"{self.bin}:{PATH}"}
        environment.pop("MAKEFLAGS", None)
        return subprocess.Popen(
            shlex.split(command), cwd=folder, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            start_new_session=True,
        )  # fmt: skip

    def do(self, folder: Path, command: str, code: int = 0) -> tuple[str, list[str]]:
        """Output of a command that ends with `code`, and the calls of l3 that it made."""
        self.calls.clear()
        process = self.start(folder, command)
        out, err = process.communicate(timeout=120)
        assert process.returncode == code, out + err
        return out, list(self.calls)


@pytest.fixture(scope="module")
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Workplace]:
    with tempfile.TemporaryDirectory() as short:  # the name of a socket must not be long
        address = f"{short}/socket"
        place = Workplace(tmp_path_factory.mktemp("bin"), address)
        with Listener(address) as listener:
            server = threading.Thread(target=place.serve, args=(listener,))
            server.start()
            yield place
            with Client(address) as caller:
                caller.send((None, None))
            server.join()


@pytest.fixture(scope="module")
def made(workplace: Workplace, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, list[str]]:
    """A folder of small recipes after `make -j`, its output and the calls of l3."""
    folder = tmp_path_factory.mktemp("pipelines") / "a camera"
    assert run(["init", "bayer", str(folder), "--quiet"]) == 0
    recipes = {
        **SMALL,
        "classes": SMALL["classes"].replace("first_draws = 0", "first_draws = 2"),
        "bands_scenes": SMALL["scenes"] + '[target]\noutputs = "camera"\n',
        "bands_classes": SMALL["classes"],
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
    assert {path.name.split("_")[-1] for path in (folder / "unseen").iterdir()} == {"raw.tif", "ideal.png"}


def test_a_second_make_has_nothing_to_do(workplace: Workplace, folder: Path) -> None:
    assert workplace.do(folder, "make -q picture.png quality.txt report.html")[1] == []
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    assert workplace.do(folder, "make -j")[1] == []
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before


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
    for asked, calls in (
        ("CAMERA=camera.toml", 6),
        ("", 7),
        ("MEASUREMENTS=virtual_lab/../virtual_lab/MEASUREMENTS.toml", 7),
    ):
        out, _ = workplace.do(folder, f"make -n {asked}")
        assert len(CALL.findall(out)) == calls, out


def test_another_camera_takes_its_unseen_frames(workplace: Workplace, folder: Path) -> None:
    shutil.copy(folder / "camera.toml", folder / "other.toml")
    cameras = {"": "camera.toml", "CAMERA=other.toml": "other.toml", "MEASUREMENTS=mine.toml": "camera.h5"}
    (folder / "mine.toml").touch()
    for asked, camera in cameras.items():
        assert f"simulate unseen.toml --camera {camera} " in workplace.do(folder, f"make -n -W unseen.toml {asked}")[0], (
            asked
        )


@pytest.mark.parametrize(("recipe", "named"), [("bayer_bggr", "bayer.toml"), ("from_curves", "from_curves.csv")])
def test_a_file_that_the_camera_is_made_of_makes_all_of_it_again(
    recipe: str, named: str, workplace: Workplace, tmp_path: Path
) -> None:
    assert run(["init", recipe, str(tmp_path / "folder"), "--quiet"]) == 0
    (tmp_path / "folder/virtual_lab").mkdir()
    measured = "virtual_lab/MEASUREMENTS.toml"
    (tmp_path / "folder" / measured).touch()
    (tmp_path / "folder/.asked").touch()
    assert "l3 lab" not in workplace.do(tmp_path / "folder", f"make -n {measured}")[0]
    assert "l3 lab" in workplace.do(tmp_path / "folder", f"make -n -W {named} {measured}")[0]


def test_a_stopped_make_goes_on_where_it_was(workplace: Workplace, folder: Path, tmp_path: Path) -> None:
    undisturbed = (folder / "training.h5").read_bytes()
    (folder / "training.h5").unlink()
    real = tmp_path / "l3"
    real.write_text(f'#!/bin/sh\nPYTHONPATH={ROOT} exec {sys.executable} -c "from l3cli.cli import main; main()" "$@"\n')
    real.chmod(0o755)
    process = workplace.start(folder, f"make L3={real} JOBS=1")
    parts = folder / "training.h5.parts"
    deadline = time.monotonic() + 60
    while not (parts / "000001.h5").exists() and time.monotonic() < deadline:
        time.sleep(0.005)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == -signal.SIGINT, out + err
    kept = {path: path.stat().st_mtime_ns for path in parts.iterdir()}
    assert len(kept) > 2
    assert not (folder / "training.h5").exists()

    workplace.do(folder, "make training.h5 L3=:")  # does what is done before and after l3
    assert {path: path.stat().st_mtime_ns for path in parts.iterdir()} == kept
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
            out, err = process.communicate(timeout=60)
            assert process.returncode == 2, out + err
            assert err.count("is being written by another run") == 1, err
            after = {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file() and path.name[0] != "."}
            assert after == before


def test_make_leaves_no_picture_of_an_earlier_recipe(workplace: Workplace, folder: Path) -> None:
    (folder / "unseen/00000_earlier_raw.tif").write_text("of an earlier recipe")
    (folder / "unseen.toml").write_text(SMALL["unseen"].replace("seed = 5", "seed = 6"))
    _, calls = workplace.do(folder, "make picture.png -o training.h5 -o table.h5 JOBS=1")
    assert calls == ["simulate .unseen.h5", "render picture.png"]
    assert sorted(path.name for path in (folder / "unseen").iterdir()) == [
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
    command = 'make -k -j2 video "VIDEO=--fps 25"'
    _, calls = workplace.do(folder, command, code=2)
    assert sorted(calls) == [f"render videos/{name}.mp4" for name in ("broken.npy", "night.npy", "street")]
    (folder / "clips/broken.npy").unlink()
    out, calls = workplace.do(folder, command)
    assert calls == []
    for name, frames in (("street", 3), ("night.npy", 4)):
        assert f"{name}.mp4" in out
        with av.open(str(folder / f"videos/{name}.mp4")) as video:
            assert video.streams.video[0].average_rate == 25
            assert sum(1 for _ in video.decode(video=0)) == frames


def test_a_slurm_cluster_learns_in_arrays(workplace: Workplace, folder: Path) -> None:
    classes = (folder / "classes.toml").read_text()
    (folder / "classes.toml").write_text("[classes]\npatch = 4\n")
    out, calls = workplace.do(folder, "./slurm.sh 2")
    steps = ["camera", "simulate", "first", "merge-first", "second", "finish"]
    assert out.splitlines() == [f"{step}: job {101 + index}" for index, step in enumerate(steps)]
    arrays = {step: [f"{step}_000{task}.h5" for task in (1, 2)] for step in ("training", "first", "second")}
    assert [call.split("/")[-1] for call in calls] == [*arrays["training"], *arrays["first"]]
    assert "patch" in (folder / "slurm/2/log/l3-first-103-1.txt").read_text()

    (folder / "classes.toml").write_text(classes)
    _, calls = workplace.do(folder, "./slurm.sh 2")
    finished = ["table.h5", "picture.png", "report.html", "evaluate"]
    assert [call.split("/")[-1] for call in calls] == [*arrays["first"], "first.h5", *arrays["second"], *finished]
    assert "ΔE00" in (folder / "slurm/2/log/l3-finish-112-0.txt").read_text()
    sets = sorted((folder / "slurm/2").glob("training_*.h5"))
    assert sets[0].read_bytes() != sets[1].read_bytes()
    whole = folder / "whole.h5"
    assert run(["train", *map(str, sets), "--classes", str(folder / "classes.toml"), "-o", str(whole), "--quiet"]) == 0
    assert (folder / "slurm/2/table.h5").read_bytes() == whole.read_bytes()


@pytest.fixture
def three_layers(folder: Path) -> Path:
    """The folder with a class recipe of three layers."""
    with (folder / "classes.toml").open("a") as classes:
        classes.write(STRUCTURE + TREE)
    return folder


def test_a_slurm_cluster_learns_further_layers(workplace: Workplace, three_layers: Path) -> None:
    out, calls = workplace.do(three_layers, "./slurm.sh 1")
    assert [line.split(":")[0] for line in out.splitlines()][2:] == [
        "first", "merge-first", "second", "merge-second", "layer2", "merge-layer2", "layer3", "finish",
    ]  # fmt: skip
    passes = ["first_0001.h5", "first.h5", "second_0001.h5", "second.h5"]
    passes += ["layer2_0001.h5", "layer2.h5", "layer3_0001.h5", "table.h5"]
    assert [call.split("/")[-1] for call in calls][1:9] == passes
    require_three_layers(three_layers, "slurm/1/table.h5", "slurm/1/training_0001.h5")


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
    assert len(calls) == sum(RULES.values())
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
