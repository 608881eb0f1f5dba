"""Clips: `l3 simulate` with moving scenes, and errors in the motion settings."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts import store
from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import open_training_set, read_part
from l3cli.io.images import read_image
from l3cli.io.sequences import find_pictures
from l3cli.recipes.load import load_recipe
from l3cli.simulation.recipe import SceneRecipe, shots
from l3cli.stages.simulation.preparation import prepare
from l3cli.stages.simulation.units import StoredFrames, simulate_unit, units_of
from tests.helpers.calls import L3, Refused
from tests.helpers.tables import colorimetric_table

CLIP = """
exposure_mean = [0.02]
[[scene]]
source = "dead leaves"
size = [96, 128]
scale = 0.5
[scene.motion]
frames = 3
size = [32, 40]
pan_pixels_per_frame = [0, 2]
shake_pixels = 0.2
[scene.motion.leaves]
count = 2
"""


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory, bayer_recipe: Path) -> Path:
    from l3cli.cli import run

    folder = tmp_path_factory.mktemp("clip")
    (folder / "clip.toml").write_text(CLIP)
    call = ("simulate", folder / "clip.toml", "--camera", bayer_recipe, "-o", folder / "clip.h5", "--quiet")
    assert run([*map(str, call), "--pictures", str(folder / "clip")]) == 0
    return folder


def test_a_clip_and_its_truth_are_numbered_files(clip: Path) -> None:
    names = sorted(path.name for path in (clip / "clip").iterdir() if path.name[0] != ".")
    kinds = ("ideal.png", "motion.exr", "raw.tif")
    assert names == [f"0000{number}_dead-leaves-0-0_{kind}" for number in range(3) for kind in kinds]
    planes, channels = read_image(clip / "clip/00001_dead-leaves-0-0_motion.exr")
    assert channels == ("down", "right", "seen")
    assert planes.shape == (32, 40, 3)
    assert np.median(planes[..., 1]) == pytest.approx(-2, abs=1)
    assert np.unique(planes[..., 2]).tolist() == [0, 1]


def test_all_frames_of_a_clip_have_one_exposure_and_each_its_own_noise(clip: Path) -> None:
    with open_training_set(clip / "clip.h5") as reader:
        frames, camera = [reader.frame(index) for index in range(len(reader))], reader.head.camera
    assert len(frames) == 3
    assert len({frame.exposure for frame in frames}) == 1
    signal = [float(frame.raw.mean() - camera.black_level) / (camera.white_level - camera.black_level) for frame in frames]
    assert signal[0] == pytest.approx(0.02, rel=0.1)
    assert not np.array_equal(frames[0].raw[:, 2:], frames[1].raw[:, :-2])


def test_the_exposure_that_is_reported_renders_as_bright_as_the_ideal(
    bayer_recipe: Path, bayer: CameraModel, tmp_path: Path, l3: L3
) -> None:
    """By a table that shows plain areas as they are."""
    recipe = CLIP.replace("[0.02]", "[0.3]").replace("dead leaves", "grey ramp") + '[sensor]\nnoise = "none"\n'
    (tmp_path / "clip.toml").write_text(recipe)
    call = ("simulate", tmp_path / "clip.toml", "--camera", bayer_recipe, "-o", tmp_path / "clip.h5")
    code, _, err = l3(*call, "--pictures", tmp_path / "clip")
    assert code == 0
    words = re.search(r"frames 0–2: .* use --exposure (\S+)", err)
    assert words
    store.save(colorimetric_table(bayer), tmp_path / "table.h5")
    raws = tmp_path / "clip/%05d_grey-ramp-0-0_raw.tif"
    render = ("render", tmp_path / "table.h5", raws, "-o", tmp_path / "out/%05d.png", "--backend", "reference", "--quiet")
    assert l3(*render, "--exposure", words[1])[0] == 0
    code, out, err = l3("evaluate", "--sequence", tmp_path / "out/%05d.png", "--ideal", tmp_path / "clip", "--json")
    assert (code, err) == (0, "")  # no word of another brightness
    options = ("--exposure", words[1], *render[5:])
    code, _, err = l3("render", tmp_path / "table.h5", tmp_path / "clip", "-o", tmp_path / "again", *options)
    assert (code, err) == (0, "")  # of the folder, too, beside its ideal pictures
    for number, path in enumerate(sorted((tmp_path / "again").glob("[!.]*"))):
        assert np.array_equal(read_image(path)[0], read_image(tmp_path / f"out/{number:05d}.png")[0])
    (tmp_path / "clip/other_ideal.png").write_bytes(b"of no raw frame")
    code, _, err = l3("render", tmp_path / "table.h5", tmp_path / "clip", "-o", tmp_path / "third", "--quiet")
    assert (code, "contains .png and .tif files" in err) == (3, True)
    (tmp_path / "clip/other_ideal.png").unlink()
    light = [np.mean(list(find_pictures(each).pictures())) for each in (tmp_path / "out", tmp_path / "clip")]
    assert light[0] == pytest.approx(light[1], rel=0.02)
    assert json.loads(out)["motion"] == "known"


def test_the_frames_are_the_same_however_they_are_shared_out(clip: Path, bayer: CameraModel, tmp_path: Path) -> None:
    run, files = prepare(load_recipe(clip / "clip.toml", SceneRecipe), clip / "clip.toml", bayer, 0)
    stored = StoredFrames(tmp_path / "clip.h5", "key")
    work = units_of(run, list(shots(run.recipe, files)), stored, workers=4)
    assert len(work) == 3
    with open_training_set(clip / "clip.h5") as reader, stored.held(resume=False, force=False):
        for number in (2, 0):
            assert simulate_unit(stored, work[number]) == 1
            part = read_part(stored.path(number))
            assert np.array_equal(part.raw, reader.frame(number).raw)
            assert part.exposure == reader.frame(number).exposure


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("size = [96, 128]", "size = [66, 80]"), "an area of up to 67×91 samples"),
        (("size = [32, 40]", "size = [12, 40]"), "motion.size has 12×40"),
        (("size = [32, 40]", "size = [320, 400]"), "larger than the sensor"),
        (("shake_pixels", "shake_pixel"), "shake_pixels"),
        (("frames = 3", "frames = 0"), "use at least 1"),
        (("frames = 3", "zoom_per_frame = 1.1"), "frames"),
        (("count = 2", "count = 1000000"), "use at most 64"),
    ],
)
def test_what_cannot_be_is_reported_before_any_work(
    change: tuple[str, str], words: str, tmp_path: Path, bayer_recipe: Path, refused: Refused, l3: L3
) -> None:
    (tmp_path / "clip.toml").write_text(CLIP.replace(*change))
    assert words in refused(2, "simulate", tmp_path / "clip.toml", "--camera", bayer_recipe, "-o", tmp_path / "clip.h5")
    code, out, _ = l3("check", tmp_path / "clip.toml", bayer_recipe)
    assert code == 3
    assert words in out
