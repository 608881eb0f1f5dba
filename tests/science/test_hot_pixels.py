"""Hot pixels that no map lists are found in a frame; stars, fine detail and clipped areas are left as they are."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.container import seal
from l3cli.artifacts.store import save
from l3cli.artifacts.training_set import TrainingFrame, open_training_set
from l3cli.frames.frame import RawFrame
from l3cli.frames.hot_pixels import HotTest
from l3cli.simulation.sensor import expose, mosaic
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import BAYER, random_camera
from tests.helpers.tables import random_table


def frame_of(camera: CameraModel, electrons: np.ndarray, seed: int = 1) -> RawFrame:
    values = expose(camera, electrons, 0.01, np.random.default_rng(seed))
    return RawFrame("f", values, camera.black_level, camera.white_level)


@pytest.mark.parametrize("bits", [12, 16])
def test_hot_pixels_are_found_and_sound_ones_kept(bayer: CameraModel, bits: int) -> None:
    scale = 2 ** (bits - 12)
    camera = replace(
        bayer, bits=bits, gain=bayer.gain * scale, black_level=64.0 * scale, white_level=bayer.white_level * scale
    )
    rng, shape = np.random.default_rng(3), (camera.rows, camera.cols)
    light = np.kron(rng.uniform(20, 9000, (24, 32)), np.ones((8, 8)))
    light[:40, :40] = 40000  # clipped
    frame, test = frame_of(camera, light), HotTest.of(camera)
    assert np.count_nonzero(test.without_hot(frame, camera.cfa).values != frame.values) == 0
    flat = frame_of(camera, np.full(shape, 500.0))
    places = rng.choice(flat.values.size, 100, replace=False)
    raised = flat.values.astype(int)
    raised.ravel()[places] += 400 * scale
    mended = test.without_hot(replace(flat, values=raised.astype(np.uint16)), camera.cfa)
    found = (mended.values != raised).ravel()
    assert found.sum() == found[places].sum() > 85  # the others touch, or a neighbour is as bright
    assert np.abs(mended.values.ravel()[places[found[places]]] - flat.values.mean()).max() < 60 * scale
    assert test.without_hot(replace(flat, values=flat.values[:4, :4]), camera.cfa).values.shape == (4, 4)


def test_stars_are_no_hot_pixels(bayer: CameraModel) -> None:
    """From 500 electrons in all on; fainter ones that half a pixel holds are as dark beside it as noise."""
    rng = np.random.default_rng(5)
    down, across = np.mgrid[-4:5, -4:5]
    for blur in (0.5, 0.7, 1.0):  # pixels; a lens at f/2.8 and half a pixel of defocus make as much
        sky = np.full((bayer.rows, bayer.cols), 100.0)
        for _ in range(200):
            row, col = rng.integers(6, bayer.rows - 6), rng.integers(6, bayer.cols - 6)
            spot = np.exp(-((down - rng.uniform(-0.5, 0.5)) ** 2 + (across - rng.uniform(-0.5, 0.5)) ** 2) / 2 / blur**2)
            sky[row - 4 : row + 5, col - 4 : col + 5] += np.exp(rng.uniform(6.2, 11)) * spot / spot.sum()
        frame = frame_of(bayer, sky)
        np.testing.assert_array_equal(HotTest.of(bayer).without_hot(frame, bayer.cfa).values, frame.values)


def test_a_simulated_frame_is_hardly_touched(pipeline: Path) -> None:
    with open_training_set(pipeline / "unseen.h5") as reader:
        frame, camera = next(iter(reader)), reader.head.camera
    assert isinstance(frame, TrainingFrame)
    for share in (1.0, 0.1, 0.01):
        raw = frame_of(camera, share * mosaic(frame.electrons, camera.cfa))
        changed = HotTest.of(camera).without_hot(raw, camera.cfa).values != raw.values
        assert changed.mean() < 5e-5


def test_render_mends_them_where_it_is_asked_to(tmp_path: Path, l3: L3, refused: Refused) -> None:
    camera = random_camera(BAYER, 3, 12, 100.0)
    save(replace(random_table(BAYER, black_level=100.0, patch=3), camera=camera), tmp_path / "table.h5")
    frame = frame_of(camera, np.full((24, 32), 3000.0)).values
    hot = frame.copy()
    hot[11, 13] += 2500
    np.save(tmp_path / "hot.npy", hot)
    call = ("render", tmp_path / "table.h5", tmp_path / "hot.npy", "--backend", "reference", "-o")
    for name, options in (("plain", ()), ("off", ("--hot", "off")), ("auto", ("--hot", "auto"))):
        assert l3(*call, tmp_path / f"{name}.exr", *options)[0] == 0
    plain, off, auto = ((tmp_path / f"{name}.exr").read_bytes() for name in ("plain", "off", "auto"))
    assert plain == off != auto
    assert "auto" in refused(2, *call, tmp_path / "no.exr", "--hot", "yes")
    with h5py.File(tmp_path / "table.h5", "r+") as root:
        del root["camera"]
    seal(tmp_path / "table.h5")
    assert "--hot needs the camera's noise" in refused(2, *call, tmp_path / "no.exr", "--hot", "auto")
