"""Real pairs: a raw file and a picture become part of a training set, and training uses them only at their CFA phase."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import TrainingFrame, TrainingPair, open_training_set
from l3cli.classes.windows import neighbourhoods
from l3cli.cli import run
from l3cli.frames.frame import RawFrame, as_taken, upright
from l3cli.io.images import read_image
from l3cli.physics.spaces import SRGB_FROM_XYZ
from l3cli.simulation.frame import make_pair
from l3cli.simulation.recipe import Pair
from l3cli.training.patches import expose_patches, lacking_variance, sample_pair
from l3cli.training.symmetry import site_maps
from tests.helpers.calls import L3, Refused

PAIR = Pair(raw="a.tif", picture="a.png", scale=0.5)


def raw_of(values: np.ndarray, camera: CameraModel, phase: tuple[int, int] = (0, 0), orientation: int = 0) -> RawFrame:
    return RawFrame("a", values.astype(np.uint16), camera.black_level, camera.white_level, phase, orientation)


@pytest.mark.parametrize("phase", [(0, 0), (1, 0), (3, 2)])
@pytest.mark.parametrize("offset", [(0, 0), (2, 5)])
def test_a_pair_begins_with_the_first_site(fiveband: CameraModel, phase: tuple[int, int], offset: tuple[int, int]) -> None:
    row, col = np.mgrid[:40, :60]
    channel = fiveband.cfa.astype(int)[(row + phase[0]) % 4, (col + phase[1]) % 4]
    values = 200 + 500 * channel
    picture = np.stack([row, col, row], axis=2)[offset[0] : 38, offset[1] : 57].astype(np.float32)
    pair = make_pair(
        raw_of(values, fiveband, phase), picture, ("X", "Y", "Z"), fiveband, Pair("a", "b", offset, scale=1.0), "x"
    )
    rows, cols = pair.raw.shape
    assert np.array_equal(pair.raw, 200 + 500 * fiveband.cfa.astype(int)[np.ix_(np.arange(rows) % 4, np.arange(cols) % 4)])
    first = pair.target[:2, 0, 0] / fiveband.saturation_exposure
    assert ((first.round() + phase) % 4 == 0).all()
    assert pair.target.shape == (3, rows, cols)


@pytest.mark.parametrize("orientation", range(8))
def test_an_upright_picture_is_turned_back_to_the_sensor(bayer: CameraModel, orientation: int) -> None:
    picture = np.random.default_rng(0).random((20, 30, 3)).astype(np.float32)
    assert np.array_equal(as_taken(upright(picture, orientation), orientation), picture)
    raw = raw_of(np.full((20, 30), 500), bayer, orientation=orientation)
    pair = make_pair(raw, upright(picture, orientation), ("X", "Y", "Z"), bayer, PAIR, "x")
    assert np.allclose(pair.target, picture.transpose(2, 0, 1) * 0.5 * bayer.saturation_exposure, rtol=1e-5)


def test_a_picture_larger_than_its_raw_is_refused(bayer: CameraModel) -> None:
    with pytest.raises(ValueError, match="beyond the raw frame"):
        make_pair(raw_of(np.full((20, 30), 500), bayer), np.ones((20, 31, 3), np.float32), ("X", "Y", "Z"), bayer, PAIR, "x")


def test_a_raw_beyond_its_cameras_bits_is_refused(bayer: CameraModel) -> None:
    raw, picture = raw_of(np.full((20, 30), 65535), bayer), np.ones((20, 30, 3), np.float32)
    with pytest.raises(ValueError, match="65535 DN, which does not fit into 12 bits"):
        make_pair(raw, picture, ("X", "Y", "Z"), bayer, PAIR, "x")
    make_pair(replace(raw, white_level=65535.0), picture, ("X", "Y", "Z"), bayer, PAIR, "x")


def a_pair(camera: CameraModel, raw: np.ndarray, target: np.ndarray) -> TrainingPair:
    return TrainingPair(raw.astype(np.uint16), target.astype(np.float32), np.ones(3), "x", "picture", 1.0, 1.0)


def test_patches_of_a_pair_have_the_layout_of_their_site(fiveband: CameraModel) -> None:
    shape = (64, 80)
    neighbours = neighbourhoods(fiveband.cfa, 9, 5)
    channel = fiveband.cfa.astype(int)[np.ix_(np.arange(64) % 4, np.arange(80) % 4)]
    target = np.broadcast_to(channel, (3, *shape)) * fiveband.saturation_exposure
    pair = a_pair(fiveband, 300 + 500 * channel, target)
    maps = site_maps(neighbours.channel, 9)
    for site in sorted({samples.canonical for samples in maps}):
        samples = sample_pair(pair, fiveband, neighbours, site, 200, np.random.default_rng(0))
        assert len(samples.signal) == 200
        taps = np.rint((samples.signal * (fiveband.white_level - fiveband.black_level) + fiveband.black_level - 300) / 500)
        assert np.array_equal(taps, np.broadcast_to(neighbours.channel[site], taps.shape))
        assert np.allclose(samples.target, neighbours.channel[site][40])


def test_noise_that_a_pair_carries_is_not_counted_twice(bayer: CameraModel) -> None:
    neighbours = neighbourhoods(bayer.cfa, 5, 3)
    rng = np.random.default_rng(0)
    mean = 0.5 * (bayer.white_level - bayer.black_level)
    noisy = bayer.black_level + mean + rng.standard_normal((128, 128)) * np.sqrt(bayer.noise_variance(np.array(mean)))
    samples = sample_pair(a_pair(bayer, np.rint(noisy), np.ones((3, 128, 128))), bayer, neighbours, 0, 4000, rng)
    assert samples.carried is not None
    span = bayer.white_level - bayer.black_level
    assert np.array_equal(samples.possible(np.full(4000, 3.0)), np.ones(4000))
    for scale in (1.0, 0.25):
        signal = samples.signal * np.float32(scale)
        carried = samples.carried * np.float32(scale**2)
        values, variance = expose_patches(signal, bayer, rng, carried), lacking_variance(signal, bayer, carried)
        expected = bayer.noise_variance(np.array(mean * scale)) / span**2
        assert signal.var() + variance.mean() == pytest.approx(expected, rel=0.02)
        assert values.var() == pytest.approx(expected * span**2, rel=0.03)
    clipped = np.where(rng.random((128, 128)) < 0.5, bayer.white_level, 500)
    samples = sample_pair(a_pair(bayer, clipped, np.ones((3, 128, 128))), bayer, neighbours, 0, 100, rng)
    assert np.array_equal(samples.possible(np.full(100, 0.1)), np.ones(100))


@pytest.fixture(scope="module")
def leaves(bayer_recipe: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of simulated frames, as leaves.h5 and, in p/, as raw files and pictures."""
    folder = tmp_path_factory.mktemp("leaves")
    (folder / "leaves.toml").write_text(
        'exposure_share = [0.9]\n[[scene]]\nsource = "dead leaves"\nsize = [160, 200]\ncount = 4\nseed = 3\n'
    )
    arguments = ["--camera", bayer_recipe, "-o", folder / "leaves.h5", "--pictures", folder / "p"]
    assert run([str(word) for word in ("simulate", folder / "leaves.toml", *arguments, "--quiet")]) == 0
    return folder


@pytest.fixture
def pair_recipe(leaves: Path, tmp_path: Path) -> str:
    """The [[pair]] tables of these frames, which lie in tmp_path."""
    shutil.copytree(leaves, tmp_path, dirs_exist_ok=True)
    raws = sorted((tmp_path / "p").glob("*_raw.tif"))
    return "".join(
        f'[[pair]]\nraw = "p/{raw.name}"\npicture = "p/{raw.name.replace("_raw.tif", "_ideal.png")}"\n' for raw in raws
    )


def test_pairs_and_frames_train_one_table(l3: L3, bayer_recipe: Path, tmp_path: Path, pair_recipe: str) -> None:
    import json

    (tmp_path / "both.toml").write_text(
        f'exposure_share = [0.9]\n[[scene]]\nsource = "dead leaves"\nsize = [96, 96]\n{pair_recipe}'
    )
    (tmp_path / "pairs.toml").write_text(pair_recipe)
    for name in ("both", "pairs"):
        code, _, err = l3("simulate", tmp_path / f"{name}.toml", "--camera", bayer_recipe, "-o", tmp_path / f"{name}.h5")
        assert code == 0, err
    with open_training_set(tmp_path / "both.h5") as reader, open_training_set(tmp_path / "leaves.h5") as truth:
        frames = list(reader)
        assert [isinstance(frame, TrainingFrame) for frame in frames] == [True, False, False, False, False]
        assert len(reader.head.history[-1].inputs["pair"]) == 8
        for pair, true in zip(frames[1:], truth, strict=True):
            assert np.array_equal(pair.raw, true.raw)
            shown = (true.target[1] < 0.95 * true.white[1]) & (true.target[1] > 0.05 * true.white[1])
            displayed = np.tensordot(SRGB_FROM_XYZ, true.target / true.white[1], 1)
            shown &= (displayed.min(axis=0) > 0) & (displayed.max(axis=0) < 1)  # other colours are clipped in pictures
            ratio = (pair.target[1] * pair.exposure)[shown] / (true.target[1] * true.exposure)[shown]
            assert np.median(ratio) == pytest.approx(1.0, abs=0.2)  # a grey world gives the scale so well
            assert ratio.std() < 0.05 * ratio.mean()
    (tmp_path / "classes.toml").write_text("[classes]\npatch = 5\nlevels = 4\n[learning]\npatches = 8000\n")
    error = {}
    for name in ("both", "pairs"):
        arguments = (tmp_path / f"{name}.h5", "--classes", tmp_path / "classes.toml", "-o", tmp_path / "t.h5", "--force")
        code, _, err = l3("train", *arguments)
        assert code == 0, err
        code, out, err = l3("evaluate", tmp_path / "t.h5", tmp_path / "leaves.h5", "--backend", "reference", "--json")
        assert code == 0, err
        error[name] = json.loads(out)["mean"]["ours"]["median_delta_e"]
    assert max(error.values()) < 8


def test_a_picture_is_turned_upright_by_its_tag(l3: L3, bayer_recipe: Path, tmp_path: Path, pair_recipe: str) -> None:
    first = pair_recipe.split("[[pair]]")[1]
    ideal = min((tmp_path / "p").glob("*_ideal.png"))
    pixels, _ = read_image(ideal)
    tifffile.imwrite(tmp_path / "p/turned.tif", pixels[::-1, ::-1], photometric="rgb", extratags=[(274, 3, 1, 3, True)])
    turned = re.sub(r'picture = ".*"', 'picture = "p/turned.tif"', first)
    (tmp_path / "two.toml").write_text(f"[[pair]]{first}[[pair]]{turned}")
    code, _, err = l3("simulate", tmp_path / "two.toml", "--camera", bayer_recipe, "-o", tmp_path / "two.h5")
    assert code == 0, err
    with open_training_set(tmp_path / "two.h5") as reader:
        one, other = reader
    np.testing.assert_array_equal(one.target, other.target)


def test_a_wrong_pair_is_one_line(
    l3: L3,
    refused: Refused,
    bayer_recipe: Path,
    tmp_path: Path,
    pair_recipe: str,
) -> None:
    first = pair_recipe.split("[[pair]]")[1]
    for text, code, words in (
        (f"[[pair]]{first}offset = [9, 0]\n", 3, "beyond the raw frame"),
        (f"[[pair]]{first}offset = [-1, 0]\n", 2, "offset"),
        (f'[target]\noutputs = "CIE 1964"\n[[pair]]{first}', 3, "no channels called X10"),
        (f'[target]\noutputs = "camera"\n[[pair]]{first}', 2, 'target.outputs "camera"'),
    ):
        (tmp_path / "scenes.toml").write_text(text)
        line = refused(code, "simulate", tmp_path / "scenes.toml", "--camera", bayer_recipe, "-o", tmp_path / "out.h5")
        assert words in line
