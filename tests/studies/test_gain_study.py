"""Estimates of the analog gain from the noise of frames, for 20 scenes of each array in the gallery.

python -m pytest -m slow -s tests/studies/test_gain_study.py -k NAME      two minutes of processor time per array

The scenes are compositions, dead leaves (one scene with patterns), skin, foliage, four faces, a measured cube, and four
photos at half size. A white reaches 0.9 of full scale at gains from 1 to 64, because the exposure is shortened accordingly.
Photos contain noise, which is attributed to the camera: for cameras with little noise, the estimate for Kodak photos at full
size is up to 30 % too high at gain 1. The estimate fails for frames with too few uniform areas: at gain 1 for seven frames
of X-Trans, whose 30 000 electrons reveal any texture, and for at most two frames of other arrays. At gain 64 the estimate
fails for dark frames, whose noise extends below black, and for five frames of `dual_iso`.
"""

import os
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera_recipe import load_camera
from l3cli.frames.frame import RawFrame
from l3cli.frames.gain_estimate import estimate_gain
from l3cli.recipes.load import load_recipe
from l3cli.simulation import sensor
from l3cli.simulation.recipe import SceneRecipe, shots
from l3cli.stages.simulation.preparation import prepare, scene_over_time
from tests.helpers.paths import CONFIGS

ARRAYS = (
    "bayer cmy dual_iso fiveband from_curves monno nona_bayer_hdr quad_bayer quad_bayer_hdr quad_rgbw rccb rccg rgbir "
    "rgbir4x4 rgbw rgbw4x4 snapshot16 xtrans"
)
DATA = Path(os.environ.get("L3_DATA", "no data"))
GAINS = 1.0, 4.0, 16.0, 64.0
WITHIN, REFUSED = 0.15, 8  # relative; of 20
BANDS = [405, 435, 450, 470, 505, 525, 570, 590, 630, 645, 660, 700, 780, 850, 870, 890, 910, 940, 970]  # nm
SYNTHETIC = (
    'source = "composition"\ncount = 4\nseed = 3',
    'source = "dead leaves"\ncount = 4\nseed = 5',
    'source = "dead leaves"\nseed = 6\npatterned = 0.3',
    'source = "skin"',
    'source = "foliage"',
)
PHOTOS = "woodDuck.png", "BanteaySrei_01.jpg", "BanteaySrei_03.jpg", "FruitMCC_6500.tif"
pytestmark = pytest.mark.slow


def write_recipe(path: Path) -> Path:
    measured = [f'source = "iset"\nfile = "{DATA}/scenes/people_small_[1246]_scene.mat"\nscale = 3.0']
    about = f'variable = "immulti"\nwhite = 255.0\nwavelengths_nm = {BANDS}'
    measured.append(f'source = "cube"\nfile = "{DATA}/scenes/multispectral_day01.mat"\n{about}')
    measured += [f'source = "rgb"\nfile = "{DATA}/pictures/{name}"\nshrink = 2' for name in PHOTOS]
    scenes = [f"{each}\nsize = [480, 640]" for each in SYNTHETIC] + measured
    path.write_text("exposure_share = [0.9]\n" + "".join(f"[[scene]]\n{each}\n" for each in scenes))
    return path


@pytest.mark.skipif(not DATA.is_dir(), reason="L3_DATA does not name the folder of real data")
@pytest.mark.parametrize("name", ARRAYS.split())
def test_the_gain_of_unlabelled_frames(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    camera, path = load_camera(CONFIGS / f"cameras/{name}.toml"), write_recipe(tmp_path / "scenes.toml")
    run, files = prepare(load_recipe(path, SceneRecipe), path, camera, 0)
    errors: dict[float, list[float]] = {gain: [] for gain in GAINS}
    taken = list(shots(run.recipe, files))
    assert len(taken) == 20
    for number, (wanted, (shot,)) in enumerate(taken):
        frame = run.frame(scene_over_time(wanted, run)(0), shot)
        electrons = sensor.mosaic(frame.electrons, camera.cfa)
        for gain in GAINS:
            amplified, rng = sensor.with_analog_gain(camera, gain), np.random.default_rng([number, int(gain)])
            values = sensor.expose(amplified, electrons / np.float32(gain), frame.exposure / gain, rng)
            try:
                estimate = estimate_gain(RawFrame(wanted.name, values, camera.black_level, camera.white_level), camera)
            except ValueError:
                continue
            errors[gain].append(estimate.gain / gain - 1.0)
    with capsys.disabled():
        for gain, each in errors.items():
            rms, most = np.sqrt(np.mean(np.square(each))), np.abs(each).max()
            print(f"\n{name}, gain {gain:g}: {rms:.1%} r.m.s., {most:.1%} at most, {20 - len(each)} of 20 refused", end="")
    for each in errors.values():
        assert np.abs(each).max() < WITHIN
        assert 20 - len(each) <= REFUSED
