"""Dark current is subtracted by exposure time, by the mean of training, or by dark frames. The noise model includes it."""

import functools
import json
import re
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.store import save
from l3cli.artifacts.table import TransformTable
from l3cli.cli import run
from l3cli.errors import InputFileError
from l3cli.frames.correction import average_dark, without_dark
from l3cli.frames.frame import RawFrame
from l3cli.io.images import read_image
from l3cli.io.pictures.openimageio import write_mosaic
from l3cli.rendering.exposure import LightMeter
from l3cli.rendering.opencl.renderer import OpenCLRenderer
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.simulation import sensor
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import BAYER, FIVE_BAND, X_TRANS, random_camera
from tests.helpers.recipes import SMALL
from tests.helpers.sequences import write_raw_video
from tests.helpers.tables import random_table

LEAKY = ("dark_current_e_per_s = 5.0", "dark_current_e_per_s = 60.0")
SCENES = """
luminances_cd_m2 = [{}]
exposure_share = [0.5]
[[scene]]
source = "composition"
size = [96, 128]
seed = 5
"""


@functools.cache
def renderers(number: int) -> tuple[TransformTable, OpenCLRenderer, ReferenceRenderer]:
    """Of a table for one of three arrays: what is compiled for it once does for every frame."""
    table = random_table((BAYER, FIVE_BAND, X_TRANS)[number], black_level=100.0, patch=7)
    return table, OpenCLRenderer(table), ReferenceRenderer(table)


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 2), st.floats(-20, 2000), st.integers(0, 2**32 - 1))
def test_a_frame_is_rendered_as_if_there_were_no_dark_current(array: int, dark: float, seed: int) -> None:
    (table, device, reference), rng = renderers(array), np.random.default_rng(seed)
    whole = round(dark)
    values = rng.integers(100, 2000, (24, 31)).astype(np.uint16)
    frame = RawFrame("f", (values.astype(int) + whole).astype(np.uint16), 100.0, table.white_level, (1, 0), dark=dark)
    np.testing.assert_array_equal(device.labels(frame), reference.labels(frame))
    np.testing.assert_allclose(device.outputs(frame), reference.exact_outputs(frame), atol=5e-6)
    # The same light, were white nearer by what dark current takes, without dark current: levels alone are another scale.
    light = RawFrame("f", values, 100.0, table.white_level - whole, (1, 0), dark=dark - whole)
    np.testing.assert_allclose(
        reference.exact_outputs(frame) * (table.white_level - 100),
        reference.exact_outputs(light) * (light.white_level - 100),
        rtol=1e-9,
    )
    assert LightMeter(table).brightness(frame) * (table.white_level - 100) == pytest.approx(
        LightMeter(table).brightness(light) * (light.white_level - 100)
    )


def test_no_level_is_lost_and_less_than_a_dn_stays_in_the_black_level() -> None:
    values = np.arange(4096, dtype=np.uint16)[None]
    frame = RawFrame("f", values, 64.0, 4095.0, dark=0.4)
    levelled = frame.at_levels(64.0, 4095.0, 12)
    np.testing.assert_array_equal(levelled.values, values)
    assert levelled.black_level == pytest.approx(64.4, abs=1e-4)
    far = replace(frame, dark=1000.3).at_levels(64.0, 4095.0, 12)
    assert far.values[0, 64 + 1000] == 64
    assert far.values[0, 4095] in (4094, 4095, 4096 - 1)
    assert (np.diff(far.values[0, 1064:].astype(int)) >= 1).all()
    with pytest.raises(ValueError, match="reaches the white level"):
        replace(frame, dark=4031.0)


def test_noise_of_dark_electrons_is_in_the_noise_model(bayer: CameraModel) -> None:
    camera = replace(bayer, rows=400, cols=400, noise=replace(bayer.noise, dark_current=60.0))
    exposure, rng = 20.0, np.random.default_rng(3)
    dark = camera.dark_signal(exposure)
    assert dark == pytest.approx(camera.gain * 1200)
    for electrons in (0.0, 500.0, 5000.0):
        raw = sensor.expose(camera, np.full((400, 400), electrons), exposure, rng)
        levelled = RawFrame("f", raw, camera.black_level, camera.white_level, dark=dark).at_levels(
            camera.black_level, camera.white_level, 12
        )
        signal = levelled.values - levelled.black_level
        share = 1 - dark / (camera.white_level - camera.black_level)
        assert signal.mean() * share == pytest.approx(camera.gain * electrons, abs=2.0)
        assert signal.var() == pytest.approx(camera.noise_variance(signal.mean(), dark), rel=0.03)
        assert signal.var() > 1.15 * camera.noise_variance(signal.mean())


def test_a_long_exposure_is_rendered_as_well_as_a_short_one(
    bayer_recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """60 e-/s: 6 e- of 15000 in a tenth of a second; 1200 e- in twenty seconds."""
    camera = tmp_path / "camera.toml"
    camera.write_text(bayer_recipe.read_text().replace(*LEAKY))
    (tmp_path / "unseen.toml").write_text(SCENES.format("200.0, 0.15"))
    (tmp_path / "scenes.toml").write_text(SMALL["scenes"])
    (tmp_path / "classes.toml").write_text(SMALL["classes"])
    assert run(["simulate", str(tmp_path / "scenes.toml"), "--camera", str(camera), "-o", str(tmp_path / "t.h5")]) == 0
    assert run(["simulate", str(tmp_path / "unseen.toml"), "--camera", str(camera), "-o", str(tmp_path / "u.h5")]) == 0
    train = ["train", tmp_path / "t.h5", "--classes", tmp_path / "classes.toml", "-o", tmp_path / "table.h5"]
    assert run([str(word) for word in train]) == 0
    capsys.readouterr()
    assert run(["evaluate", str(tmp_path / "table.h5"), str(tmp_path / "u.h5"), "--json", "--backend", "reference"]) == 0
    short, long = (frame["ours"]["mean_delta_e"] for frame in json.loads(capsys.readouterr().out)["frames"])
    with h5py.File(tmp_path / "u.h5") as root:
        times = [root[f"frames/{index:05d}/exposure"][()] for index in range(2)]
    assert 60 * times[1] > 1000 > 60 > 60 * times[0]
    assert long < short + 0.4  # of 6


# --------------------------------------------------------------------------------------------------------- dark frames


def test_dark_frames_take_off_hot_pixels_and_fixed_pattern_but_add_no_noise(bayer: CameraModel) -> None:
    camera = replace(bayer, noise=replace(bayer.noise, dark_current=40.0, dsnu=30.0))
    shape, exposure, rng = (96, 128), 10.0, np.random.default_rng(7)
    hot = rng.random(shape) < 0.002
    extra = np.where(hot, rng.integers(200, 2000, shape), 0)

    def exposed(electrons: float, seed: int) -> RawFrame:
        light = np.full(shape, electrons, np.float32)
        values = sensor.expose(camera, light, exposure, np.random.default_rng(seed)) + extra
        return RawFrame("f", np.minimum(values, 4095).astype(np.uint16), camera.black_level, camera.white_level)

    light = exposed(2000.0, 1)
    spread = light.values.std()
    for count, most in ((1, 1.05), (4, 0.89), (16, 0.86)):
        dark = average_dark(exposed(0.0, 100 + seed) for seed in range(count))
        assert dark.level == pytest.approx(camera.black_level + camera.dark_signal(exposure), abs=0.5)
        frame = without_dark(light, dark)
        assert frame.dark == pytest.approx(camera.dark_signal(exposure), abs=0.5)
        usual = light.values[~hot].std()
        assert frame.values.std() < most * usual < spread  # 12.3 DN: shot 12.2, fixed pattern 7.5 and 2.5
        assert np.abs(frame.values[hot].astype(float) - frame.values[~hot].mean()).max() < 6 * usual


def test_clipped_pixels_stay_clipped(bayer: CameraModel) -> None:
    values = np.full((8, 8), 4095, np.uint16)
    darks = np.full((8, 8), 80, np.uint16)
    darks[2, 3] = 900
    dark = average_dark([RawFrame("d", darks, bayer.black_level, bayer.white_level)])
    frame = without_dark(RawFrame("f", values, bayer.black_level, 4095.0), dark)
    np.testing.assert_array_equal(frame.values, 4095)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"values": np.zeros((8, 10), np.uint16)}, "8×8"),
        ({"phase": (1, 0)}, "phase"),
        ({"exposure": 4.0}, "2 s, but f has 4 s"),
    ],
)
def test_a_dark_frame_of_another_kind_is_refused(change: dict, message: str) -> None:
    whole = RawFrame("f", np.full((8, 8), 70, np.uint16), 64.0, 4095.0, exposure=2.0)
    dark = average_dark([replace(whole, name="d.tif")])
    with pytest.raises(InputFileError, match=re.escape(message)):
        without_dark(replace(whole, **change), dark)
    with pytest.raises(InputFileError, match="differ"):
        average_dark([whole, replace(whole, **change)])


# ------------------------------------------------------------------------------------------------------------- l3 render


@pytest.fixture
def leaky(tmp_path: Path) -> Path:
    """A table of a camera whose dark current makes 100 DN/s, and a grey frame of 3 s as .npy, 300 DN too bright."""
    camera = random_camera(BAYER, 3, 12, 100.0)
    camera = replace(camera, noise=replace(camera.noise, dark_current=100.0 / camera.gain))
    table = replace(random_table(BAYER, black_level=100.0, patch=3), exposure=0.1, camera=camera)
    save(table, tmp_path / "table.h5")
    rng = np.random.default_rng(1)
    np.save(tmp_path / "light.npy", rng.integers(900, 1500, (24, 32)).astype(np.uint16))
    np.save(tmp_path / "frame.npy", np.load(tmp_path / "light.npy") + np.uint16(300))
    np.save(tmp_path / "dark.npy", np.full((24, 32), 400, np.uint16))
    return tmp_path


def picture(folder: Path, l3: L3, *options: object) -> tuple[bytes, str]:
    """The values of a rendered frame, and what was said. Files of equal values state what they know of the exposure."""
    code, _, err = l3("render", folder / "table.h5", folder / "frame.npy", "-o", folder / "out.exr", "--force", *options)
    assert code == 0, err
    return read_image(folder / "out.exr")[0].tobytes(), err


def test_exposure_time_or_dark_frame_or_training_states_what_is_subtracted(leaky: Path, l3: L3) -> None:
    by_time, words = picture(leaky, l3, "--exposure-time", 3)
    assert "dark current" not in words
    by_frame, words = picture(leaky, l3, "--dark", leaky / "dark.npy")
    assert "dark current" not in words
    assert by_time == by_frame
    assumed, words = picture(leaky, l3)
    assert words.startswith(
        f"{leaky / 'frame.npy'}: the exposure time is unknown, so l3 subtracts the dark current for 0.1 s"
    )
    assert "(10 DN)" in words
    assert assumed != by_time
    assert picture(leaky, l3, "--exposure-time", 0.1)[0] == assumed
    assert "dark" not in picture(leaky, l3, "--quiet")[1]


def test_many_dark_frames_are_a_sequence_or_several_options(leaky: Path, l3: L3) -> None:
    one, _ = picture(leaky, l3, "--dark", leaky / "dark.npy")
    np.save(leaky / "stack.npy", np.full((5, 24, 32), 400, np.uint16))
    write_raw_video(leaky / "dark.mkv", mosaics=np.full((3, 24, 32), 400, np.uint16))  # its end alone says how many
    assert picture(leaky, l3, "--dark", leaky / "dark.mkv")[0] == one
    assert picture(leaky, l3, "--dark", leaky / "stack.npy")[0] == one
    assert picture(leaky, l3, "--dark", leaky / "dark.npy", "--dark", leaky / "dark.npy")[0] == one


def test_what_cannot_be_taken_off_is_refused(leaky: Path, refused: Refused) -> None:
    render = ("render", leaky / "table.h5", leaky / "frame.npy", "-o", leaky / "out.exr")
    assert "frame.npy" in refused(3, *render, "--exposure-time", 3000)
    assert "--exposure-time" in refused(2, *render, "--exposure-time", -1)
    np.save(leaky / "small.npy", np.zeros((8, 8), np.uint16))
    assert "small.npy" in refused(3, *render, "--dark", leaky / "small.npy")
    np.save(leaky / "bright.npy", np.full((24, 32), 4095, np.uint16))
    assert "bright.npy" in refused(3, *render, "--dark", leaky / "bright.npy")
    assert "nowhere.npy" in refused(3, *render, "--dark", leaky / "nowhere.npy")


def test_frames_of_simulate_state_their_exposure_time(pipeline: Path, l3: L3, tmp_path: Path) -> None:
    options = ("--camera", pipeline / "camera.toml", "-o", tmp_path / "u.h5")
    l3("simulate", pipeline / "unseen.toml", *options, "--pictures", tmp_path / "tif", "--dng", tmp_path / "dng", "--quiet")
    rendered, shown = [], ("--white", "table", "--backend", "reference")
    for name in ("tif", "dng"):
        raw = next(path for path in (tmp_path / name).iterdir() if path.suffix == f".{name}")
        code, _, err = l3("render", pipeline / "table.h5", raw, "-o", tmp_path / f"{name}.png", *shown)
        assert code == 0
        assert "exposure time is unknown" not in err
        rendered.append(read_image(tmp_path / f"{name}.png")[0].tobytes())
    assert rendered[0] == rendered[1]


def test_a_mosaic_keeps_its_exposure_time(tmp_path: Path, leaky: Path, l3: L3) -> None:
    write_mosaic(leaky / "frame.tif", np.load(leaky / "frame.npy"), 3.0)
    code, _, err = l3("render", leaky / "table.h5", leaky / "frame.tif", "-o", leaky / "tif.exr")
    assert code == 0
    assert "dark current" not in err
    assert read_image(leaky / "tif.exr")[0].tobytes() == picture(leaky, l3, "--exposure-time", 3)[0]
