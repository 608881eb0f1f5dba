"""`l3 simulate`: the same bytes for the same recipe, and one line for each wrong recipe."""

import dataclasses
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import TrainingFrame, open_training_set
from l3cli.frames.scene import shown_alike
from l3cli.simulation import procedural
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import bayer_camera
from tests.helpers.paths import CONFIGS


def test_frames_are_scenes_times_lights_times_exposures(l3: L3, bayer_recipe: Path, tmp_path: Path) -> None:
    recipe = tmp_path / "scenes.toml"
    recipe.write_text(
        'illuminants = ["D65", "A"]\nluminances_cd_m2 = [10.0, 100.0]\nexposure_share = [0.9]\n'
        '[[scene]]\nsource = "dead leaves"\nsize = [32, 48]\ncount = 2\n'
        '[[scene]]\nsource = "colorchecker"\nsize = [64, 96]\n'
    )
    output, pictures = tmp_path / "new/training.h5", tmp_path / "new/pictures"
    code, out, err = l3("simulate", recipe, "--camera", bayer_recipe, "-o", output, "--seed", 5, "--pictures", pictures)
    assert (code, out) == (0, ""), err
    with open_training_set(output) as reader:
        frames = [frame for frame in reader if isinstance(frame, TrainingFrame)]
        stage = reader.head.history[-1]
    assert len(frames) == 3 * 2 * 2
    assert [frame.illuminant for frame in frames[:4]] == ["D65", "D65", "A", "A"]
    assert {frame.scene for frame in frames} == {"dead leaves 0.0", "dead leaves 0.1", "colorchecker 0.0"}
    assert list(frames[7].seed) == [5, 7]
    assert frames[1].luminance == pytest.approx(100.0)
    assert np.allclose(frames[0].electrons, frames[1].electrons, rtol=1e-5)  # exposure makes up for luminance
    assert np.allclose(10 * frames[0].target, frames[1].target, rtol=1e-5)
    assert (stage.command, stage.options) == ("simulate", {"seed": 5})
    assert "dead leaves" in stage.recipe
    assert "small Bayer" in stage.recipe
    assert str(tmp_path) not in json.dumps(dataclasses.asdict(stage))
    assert len(list(pictures.glob("*_raw.tif"))) == len(list(pictures.glob("*_ideal.png"))) == len(frames)


def test_a_scene_recipe_takes_illuminances(l3: L3, refused: Refused, bayer_recipe: Path, tmp_path: Path) -> None:
    """A perfect white has a luminance of its illuminance over π."""
    recipe, output = tmp_path / "scenes.toml", tmp_path / "training.h5"
    scene = '[[scene]]\nsource = "dead leaves"\nsize = [32, 48]\n'
    recipe.write_text(f"lux = [5, 100]\nexposure_s = [0.02]\n{scene}")
    assert l3("simulate", recipe, "--camera", bayer_recipe, "-o", output)[0] == 0
    with open_training_set(output) as reader:
        assert [frame.luminance for frame in reader] == pytest.approx([5 / np.pi, 100 / np.pi])
        assert [frame.white[1] for frame in reader] == pytest.approx([5 / np.pi, 100 / np.pi])
    recipe.write_text(f"lux = [5]\nluminances_cd_m2 = [1]\nexposure_s = [0.02]\n{scene}")
    refused(2, "simulate", recipe, "--camera", bayer_recipe, "-o", tmp_path / "other.h5")


def test_frames_state_what_they_show_whatever_the_camera_sees(l3: L3, bayer_recipe: Path, tmp_path: Path) -> None:
    (tmp_path / "uv.toml").write_text(bayer_camera().replace("[400, 700, 10]", "[350, 830, 10]"))
    (tmp_path / "lamp.csv").write_text("nm,power\n" + "".join(f"{nm},{nm}\n" for nm in range(380, 781, 10)))
    text = (
        'illuminants = ["D65", "lamp.csv"]\nluminances_cd_m2 = [10.0, 100.0]\nexposure_share = [0.9]\n'
        '[[scene]]\nsource = "dead leaves"\nsize = [32, 48]\nscale = 1.5\n'
    )
    (tmp_path / "scenes.toml").write_text(text)
    (tmp_path / "moving.toml").write_text(
        text + "motion = { frames = 2, size = [24, 32], pan_pixels_per_frame = [0.0, 1.0], leaves = { count = 3 } }\n"
    )
    frames = {}
    for recipe in ("scenes", "moving"):
        for camera, seed in ((bayer_recipe, 5), (tmp_path / "uv.toml", 5), (bayer_recipe, 6)):
            file = tmp_path / f"{recipe}{camera.stem}{seed}.h5"
            code, _, err = l3("simulate", tmp_path / f"{recipe}.toml", "--camera", camera, "-o", file, "--seed", seed)
            assert code == 0, err
            with open_training_set(file) as reader:
                frames[camera.stem == "uv", seed] = list(reader)
        place, there, elsewhere = (frames[key] for key in ((False, 5), (True, 5), (False, 6)))
        shown = [[vars(frame.shown) for frame in each] for each in (place, there, elsewhere)]
        assert all(shown_alike(one, other) for one, other in zip(*shown[:2], strict=True))
        assert not any(shown_alike(one, other) for one, other in zip(shown[0], shown[2], strict=True))
        assert shown[0][0]["light"] != shown[0][-1]["light"]  # that of a file
        for one, other in zip(place, there, strict=True):  # what is known beyond the visible ends hardly matters to an eye
            np.testing.assert_allclose(one.target, other.target, atol=2e-3 * one.luminance)


def test_pictures_hold_the_raw_frame_and_a_white_that_is_white(l3: L3, bayer_recipe: Path, tmp_path: Path) -> None:
    from l3cli.io.images import read_image

    recipe = tmp_path / "chart.toml"
    recipe.write_text('illuminants = ["A"]\nexposure_share = [0.9]\n[[scene]]\nsource = "colorchecker"\nsize = [128, 192]\n')
    code, _, err = l3("simulate", recipe, "--camera", bayer_recipe, "-o", tmp_path / "t.h5", "--pictures", tmp_path / "p")
    assert code == 0, err
    with open_training_set(tmp_path / "t.h5") as reader:
        raw = reader.frame(0).raw
    stored, names = read_image(next((tmp_path / "p").glob("*_raw.tif")))
    assert stored.dtype == np.uint16
    assert len(names) == 1
    assert np.array_equal(stored[..., 0], raw)
    ideal, _ = read_image(next((tmp_path / "p").glob("*_ideal.png")))
    rows, cols = procedural.colorchecker_patches((128, 192))[21]  # neutral 5
    patch = ideal[rows, cols].reshape(-1, 3).astype(int)
    assert np.ptp(patch.mean(axis=0)) < 4
    assert 128 < patch.mean() < 135  # of its white, the 99th percentile of Y


def test_the_ideal_picture_has_exposure_and_white_of_the_rendered_one(
    l3: L3, bayer_recipe: Path, bayer: CameraModel, tmp_path: Path
) -> None:
    """By default, of every frame: the greys of the chart are within three codes, whatever share of the range they fill."""
    from l3cli.artifacts.store import save
    from l3cli.io.images import read_image
    from tests.helpers.tables import colorimetric_table

    recipe, table = tmp_path / "chart.toml", tmp_path / "table.h5"
    recipe.write_text('exposure_share = [0.9, 0.3]\n[[scene]]\nsource = "colorchecker"\nsize = [128, 192]\n')
    simulate = ("simulate", recipe, "--camera", bayer_recipe, "-o", tmp_path / "t.h5", "--pictures", tmp_path / "p")
    assert l3(*simulate, "--quiet")[0] == 0
    save(colorimetric_table(bayer), table)
    patches = procedural.colorchecker_patches((128, 192))[18:24]
    for raw in sorted((tmp_path / "p").glob("*_raw.tif")):
        assert l3("render", table, raw, "-o", tmp_path / "picture.png", "--force", "--quiet")[0] == 0
        shown = [
            read_image(path)[0] for path in (tmp_path / "picture.png", Path(str(raw).replace("_raw.tif", "_ideal.png")))
        ]
        rendered, ideal = ([np.median(each[patch].reshape(-1, 3), axis=0) for patch in patches] for each in shown)
        np.testing.assert_allclose(rendered, ideal, atol=3)
        assert np.max(ideal) > 245


@pytest.mark.usefixtures("same_workers")
def test_the_same_bytes_whatever_the_number_of_jobs(l3: L3, bayer_recipe: Path, tmp_path: Path) -> None:
    """And whether a recipe is called by its name or by its file."""
    for jobs, scenes in ((1, CONFIGS / "scenes/small.toml"), (2, "small")):
        arguments = ("--camera", bayer_recipe, "-o", tmp_path / f"{jobs}.h5", "--jobs", jobs, "--quiet")
        assert l3("simulate", scenes, *arguments) == (0, "", "")
    first = (tmp_path / "1.h5").read_bytes()
    assert first == (tmp_path / "2.h5").read_bytes()
    other = ("--camera", bayer_recipe, "-o", tmp_path / "other.h5", "--seed", 1)
    assert l3("simulate", CONFIGS / "scenes/small.toml", *other)[0] == 0
    assert first != (tmp_path / "other.h5").read_bytes()


def test_a_killed_run_goes_on_to_the_same_bytes(l3: L3, refused: Refused, bayer_recipe: Path, tmp_path: Path) -> None:
    small = CONFIGS / "scenes/small.toml"
    arguments = ("simulate", small, "--camera", bayer_recipe, "--quiet", "-o")
    assert l3(*arguments, tmp_path / "whole.h5")[0] == 0
    assert not (tmp_path / "whole.h5.parts").exists()
    command = [sys.executable, "-c", "from l3cli.cli import main; main()", *map(str, arguments), str(tmp_path / "cut.h5")]
    parts = tmp_path / "cut.h5.parts"
    with subprocess.Popen(command) as process:
        while process.poll() is None and len(list(parts.glob("0*.h5"))) < 3:
            time.sleep(0.01)
        process.kill()
    stored = sorted(parts.glob("0*.h5"))
    assert 3 <= len(stored) < 9
    assert not (tmp_path / "cut.h5").exists()
    stored[1].write_bytes(stored[1].read_bytes()[:1000])  # as after a power cut
    left = stored[0].stat().st_mtime_ns
    assert (tmp_path / ".cut.h5.l3lock").exists()
    assert "recipe" in l3(*arguments, tmp_path / "cut.h5", "--resume", "--seed", 4)[2]
    assert not (tmp_path / ".cut.h5.l3lock").exists()
    assert stored[0].stat().st_mtime_ns == left
    assert l3(*arguments, tmp_path / "cut.h5", "--resume") == (0, "", "")
    assert (tmp_path / "cut.h5").read_bytes() == (tmp_path / "whole.h5").read_bytes()
    assert not parts.exists()


HEAD = 'illuminants = ["D65"]\nexposure_share = [0.9]\n'
LEAVES = '[[scene]]\nsource = "dead leaves"\nsize = [32, 32]\n'


@pytest.mark.parametrize(
    ("text", "code", "words"),
    [
        (HEAD + '[[scene]]\nsource = "dead leaves"\n', 2, "size"),
        (HEAD + '[[scene]]\nsource = "dead leaves"\nsize = [15, 32]\n', 2, "size"),
        (HEAD + '[[scene]]\nsource = "dead leaves"\nsize = [32, 3200]\n', 2, "larger than the sensor"),
        (HEAD + '[[scene]]\nsource = "iset"\nfile = "no/such/*.mat"\n', 3, "does not exist"),
        (HEAD.replace("D65", "daylight") + LEAVES, 2, "daylight"),
        (HEAD.replace("D65", "scene") + LEAVES, 2, "no illuminant of its own"),
        (HEAD.replace("D65", "3K") + LEAVES, 2, "3K"),
        (HEAD + "exposure_s = [0.1]\n" + LEAVES, 2, "exposure_share"),
        (HEAD.replace("0.9", "-1") + LEAVES, 2, "exposure_share[1]"),
        ("exposure_saturated = [1.0]\n" + LEAVES, 2, "exposure_saturated[1]"),
        (HEAD + '[[pair]]\nraw = "a.dng"\npicture = "a.png"\n', 3, "a.dng"),
        (HEAD, 2, "contains no scenes"),
    ],
)
def test_a_wrong_recipe_is_one_line(
    refused: Refused, bayer_recipe: Path, tmp_path: Path, text: str, code: int, words: str
) -> None:
    recipe = tmp_path / "scenes.toml"
    recipe.write_text(text)
    assert words in refused(code, "simulate", recipe, "--camera", bayer_recipe, "-o", tmp_path / "out.h5")


@pytest.mark.parametrize(
    "lines",
    [
        ["400,1", "450,1", "700,1"],
        ["400,1", "410,nan", "420,1"],
        ["400,1", "410,,", "420,1"],
        ["420,1", "410,1", "430,1"],
        [f"{nm},1" for nm in range(450, 620, 10)],
        [f"{nm},{500 - nm}" for nm in range(400, 710, 10)],
    ],
)
def test_a_wrong_lamp_is_one_line(refused: Refused, bayer_recipe: Path, tmp_path: Path, lines: list[str]) -> None:
    (tmp_path / "lamp.csv").write_text("\n".join(["nm,W", *lines]))
    (tmp_path / "scenes.toml").write_text(HEAD.replace("D65", "0.5 lamp.csv + 0.5 D65") + LEAVES)
    line = refused(3, "simulate", tmp_path / "scenes.toml", "--camera", bayer_recipe, "-o", tmp_path / "out.h5")
    assert "lamp.csv" in line


def test_an_unknown_channel_in_the_colour_filter_array_is_one_line(refused: Refused, tmp_path: Path) -> None:
    (tmp_path / "camera.toml").write_text(bayer_camera(pattern=("r g", "g w")))
    arguments = ("--camera", tmp_path / "camera.toml", "-o", tmp_path / "out.h5")
    assert '"w"' in refused(2, "simulate", CONFIGS / "scenes/small.toml", *arguments)


def test_fixed_exposure_needs_an_absolute_camera(refused: Refused, bayer: CameraModel, tmp_path: Path) -> None:
    from l3cli.artifacts.store import save

    save(dataclasses.replace(bayer, absolute=False), tmp_path / "relative.h5")
    (tmp_path / "scenes.toml").write_text("exposure_s = [0.01]\n" + LEAVES)
    arguments = (tmp_path / "scenes.toml", "--camera", tmp_path / "relative.h5", "-o", tmp_path / "out.h5")
    assert "exposure_share" in refused(2, "simulate", *arguments)
