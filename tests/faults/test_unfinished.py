"""Pictures of a training set or an evaluation: the next run completes the pictures of a killed run."""

import importlib
import os
import shutil
import signal
from pathlib import Path

import pytest

from l3cli.cli import run
from l3cli.system.checkpoint import Checkpoint
from l3cli.system.files import FINISHED
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import bayer_camera

SCENES = 'exposure_share = [0.9]\n[[scene]]\nsource = "dead leaves"\nsize = [32, 40]\ncount = 3\n'
SIMULATE = "simulate scenes.toml --camera camera.toml -o out/set.h5 --pictures out/pictures --dng out/dng --quiet"
EVALUATE = "evaluate table.h5 set.h5 --pictures out/pictures --backend reference --quiet"


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("unfinished")
    (folder / "scenes.toml").write_text(SCENES)
    (folder / "camera.toml").write_text(bayer_camera())
    (folder / "classes.toml").write_text("[classes]\npatch = 3\nlevels = 4\n[learning]\npatches = 2000\nfirst_draws = 0\n")
    scenes, camera, classes = (str(folder / f"{name}.toml") for name in ("scenes", "camera", "classes"))
    for name, seed in {"training": "1", "set": "0"}.items():
        call = ["simulate", scenes, "--camera", camera, "--seed", seed, "-o", str(folder / f"{name}.h5"), "--quiet"]
        assert run(call) == 0
    call = ["train", str(folder / "training.h5"), "--classes", classes, "-o", str(folder / "table.h5"), "--quiet"]
    assert run(call) == 0
    return folder


@pytest.fixture
def folder(inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for path in inputs.iterdir():
        shutil.copy(path, tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def contents() -> dict[str, bytes]:
    """Everything in the output folder, hidden files too."""
    return {str(path): path.read_bytes() for path in Path("out").rglob("*") if path.is_file()}


def kill(line: str, module: str, function: str, count: int) -> dict[str, bytes]:
    """End `l3 LINE` by SIGKILL after so many calls of a function; what is left."""
    place = importlib.import_module(f"l3cli.{module}")
    real, calls = getattr(place, function), []

    def deadly(*arguments: object) -> object:
        calls.append(real(*arguments))
        if len(calls) == count:
            os.kill(os.getpid(), signal.SIGKILL)
        return calls[-1]

    child = os.fork()
    if not child:
        setattr(place, function, deadly)
        os._exit(run(line.split()))
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    return contents()


@pytest.mark.parametrize(
    ("module", "function", "count"),
    [("io.pictures.registry", "write_picture", 2), ("io.pictures.dng", "write_dng", 1)],
)
def test_a_simulation_killed_among_its_pictures_is_finished(
    module: str, function: str, count: int, folder: Path, l3: L3
) -> None:
    assert l3(*SIMULATE.split()) == (0, "", "")
    whole = contents()
    assert len(whole) == 1 + 3 * 3 + 2  # with a marker in each folder
    shutil.rmtree("out")
    left = kill(SIMULATE, module, function, count)
    assert "out/set.h5" not in left  # whoever finds the set finds its pictures, too
    assert l3(*SIMULATE.split(), "--resume", "--seed", "1")[0] in (1, 2)  # another run
    frames = sorted(Path("out/set.h5.parts").glob("0*.h5"))

    assert len(frames) == 3
    from l3cli.stages.simulation import units

    made = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(units, "write_part", lambda *arguments: made.append(arguments))
        assert l3(*SIMULATE.split(), "--resume") == (0, "", "")
    assert made == []
    assert contents() == whole
    code, _, err = l3(*SIMULATE.replace("--quiet", "--resume").split())
    assert (code, "out/set.h5" in err) == (0, True)
    assert contents() == whole


def test_a_simulation_killed_among_its_pictures_can_be_begun_anew(folder: Path, l3: L3, refused: Refused) -> None:
    assert l3(*SIMULATE.split()) == (0, "", "")
    whole = contents()
    assert "out/set.h5" in refused(1, *SIMULATE.split())
    shutil.rmtree("out")
    kill(SIMULATE, "io.pictures.registry", "write_picture", 2)
    assert l3(*SIMULATE.split()) == (0, "", "")  # what is there is of the same run: no --force is asked for
    assert contents() == whole
    Path("out/set.h5").unlink()
    assert "out/pictures" in refused(1, *SIMULATE.split())  # that run has ended


def test_another_run_is_kept_off_the_pictures_of_a_killed_one(folder: Path, l3: L3) -> None:
    left = kill(SIMULATE, "io.pictures.registry", "write_picture", 2)
    code, _, err = l3(*SIMULATE.split(), "--seed", "1")
    assert (code, err.count("\n")) == (1, 1)
    assert "out/pictures" in err
    assert contents().items() >= {name: left[name] for name in left if "l3lock" not in name}.items()


def test_pictures_that_are_missing_next_to_a_set_are_made_of_it(folder: Path, l3: L3, refused: Refused) -> None:
    assert l3(*SIMULATE.split()) == (0, "", "")
    whole = contents()
    shutil.rmtree("out/pictures")
    before = Path("out/set.h5").stat().st_mtime_ns
    other = SIMULATE.replace("out/dng", "out/new_dng")
    assert "out/set.h5" in refused(1, *other.split(), "--resume", "--seed", "1")  # it is of another run
    assert l3(*other.split(), "--resume") == (0, "", "")
    assert Path("out/set.h5").stat().st_mtime_ns == before
    again = contents()
    assert {name: again[name] for name in whole} == whole
    assert {name.replace("new_dng", "dng"): content for name, content in again.items()} == whole


def test_a_run_killed_when_all_is_there_leaves_nothing_to_the_next(folder: Path, l3: L3) -> None:
    assert l3(*SIMULATE.split()) == (0, "", "")
    whole = contents()
    shutil.rmtree("out")
    left = kill(SIMULATE, "stages.simulation.simulate", "_assemble", 1)
    assert left.keys() > {name for name in whole if not name.endswith(FINISHED)}
    assert l3(*SIMULATE.split(), "--resume") == (0, "", "")
    assert contents() == whole


def test_an_evaluation_killed_among_its_pictures_is_finished(folder: Path, l3: L3, refused: Refused) -> None:
    code, words, err = l3(*EVALUATE.split())
    assert (code, err) == (0, "")
    whole = contents()
    assert len(whole) >= 3 * 4
    assert "out/" in refused(1, *EVALUATE.split())
    shutil.rmtree("out")
    left = kill(EVALUATE, "stages.evaluation", "write_picture", 6)
    assert {name for name in left if name.endswith(".png")} < whole.keys()
    other = "is not empty; add --force"
    assert other in l3(*EVALUATE.replace("set.h5", "training.h5").split())[2]
    assert other in l3(*EVALUATE.split(), "--viewing", "30")[2]
    assert l3(*EVALUATE.split()) == (0, words, "")
    assert contents() == whole


def test_frames_of_another_run_are_given_up_by_force(folder: Path, l3: L3) -> None:
    line = SIMULATE.partition(" --pictures")[0] + " --quiet"
    assert l3(*line.split()) == (0, "", "")
    whole = contents()
    shutil.rmtree("out")
    kill(f"{line} --seed 1", "artifacts.container", "open_file", 1)
    assert "remove --resume or add --force" in l3(*line.split(), "--resume")[2]
    assert l3(*line.split(), "--resume", "--force") == (0, "", "")
    assert contents() == whole


def test_what_a_killed_run_left_of_its_checkpoint_is_removed(tmp_path: Path) -> None:
    remnant = tmp_path / "..clip.mkv.01234567.l3tmp.l3-unfinished"
    remnant.write_text("key")
    checkpoint = Checkpoint(tmp_path / ".clip.mkv.l3-unfinished", "key")
    checkpoint.begin()
    assert not remnant.exists()
    assert checkpoint.path.read_text() == "key"
