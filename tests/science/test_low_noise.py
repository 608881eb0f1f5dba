"""The second set of transforms for less noise: training, unchanged usual set, and the commands that use the second set."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel, NoiseScale
from l3cli.artifacts.partial_sums import open_partial_sums, write_partial_sums
from l3cli.artifacts.plane_rules import GradientScale
from l3cli.artifacts.schema import equal
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingFrame, open_training_set
from l3cli.errors import InputFileError
from l3cli.frames.frame import NoiseLeft, RawFrame
from l3cli.rendering.conditions import noise_limits
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.rendering.renderer import NoiseRenderer
from l3cli.simulation import sensor
from l3cli.training.patches import expose_patches
from tests.helpers.artifacts import some_layer_sums, some_sums
from tests.helpers.calls import Refused
from tests.helpers.cameras import BAYER
from tests.helpers.paths import CONFIGS
from tests.helpers.tables import random_table, with_low_noise, with_refinement, with_tree

LEAVES = 'exposure_share = [0.9]\n[[scene]]\nsource = "dead leaves"\nsize = [56, 56]\ncount = 3\n'
CLASSES = "[classes]\npatch = 3\nlevels = 3\nchromas = 2\n[classes.direction]\n[learning]\npatches = 1200\nfirst_draws = 1\n"
LAYER = "draws = 2\n[[layer]]\nside = 3\nmosaics = 8\nrows = 500\n"


@pytest.fixture(scope="module")
def learned(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A table of one set, and one of two, of the same training set."""
    from l3cli.cli import run

    folder = tmp_path_factory.mktemp("quiet")
    (folder / "scenes.toml").write_text(LEAVES)
    camera = CONFIGS / "cameras/bayer.toml"
    calls: list[tuple[Any, ...]] = [("simulate", folder / "scenes.toml", "--camera", camera, "-o", folder / "set.h5")]
    for name, key in (("one", ""), ("two", "noise_left = 0.1\n")):
        (folder / f"{name}.toml").write_text(CLASSES + key + LAYER)
        calls.append(("train", folder / "set.h5", "--classes", folder / f"{name}.toml", "-o", folder / f"{name}.h5"))
    for call in calls:
        assert run([*map(str, call), "--quiet"]) == 0
    return {path.name: path for path in folder.iterdir()}


def at_noise(camera: CameraModel, share: float) -> CameraModel:
    return dataclasses.replace(camera, noise_left=share)


def test_noise_over_time_falls_and_what_pixels_differ_by_stays(bayer: CameraModel) -> None:
    dark = 3.0
    whole, filtered = bayer.noise_terms(dark), at_noise(bayer, 0.25).noise_terms(dark)
    still = dataclasses.replace(bayer, noise=dataclasses.replace(bayer.noise, dsnu=0.0, prnu=0.0, column_noise=0.0))
    moving, span = still.noise_terms(dark), bayer.white_level - bayer.black_level
    rounding = (span / (span - dark)) ** 2 / 12
    assert whole[0] - filtered[0] == pytest.approx(0.75 * (moving[0] - rounding))
    assert whole[1] - filtered[1] == pytest.approx(0.75 * moving[1])
    assert whole[2] == filtered[2]


def test_the_usual_set_is_what_it_would_be_alone(learned: dict[str, Path]) -> None:
    """That for low noise decides by lower edges."""
    one, two = (load(TransformTable, learned[f"{name}.h5"]) for name in ("one", "two"))
    assert equal(dataclasses.replace(two, conditions=()), one)
    assert not one.conditions
    assert two.conditions[0].noise == NoiseScale(noise_left=0.1)
    usual, low = two.first.rule, two.under(two.conditions[0]).first.rule
    assert (low.contrast_edges <= usual.contrast_edges).all()
    assert (low.contrast_edges[:, :2] < 0.5 * usual.contrast_edges[:, :2]).all()  # darkest: noise that varies in time
    edges, lower = (rule.feature_list[0].constants[5:] for rule in (usual, low))
    assert (lower < edges).all()


def test_each_set_is_best_at_the_noise_that_it_is_learned_for(learned: dict[str, Path]) -> None:
    """Of a dark scene with all of its camera's noise, and with a tenth of what varies in time."""
    table = load(TransformTable, learned["two.h5"])
    assert table.camera is not None
    sets = [table, table.under(table.conditions[0])]
    renderers = [ReferenceRenderer(each) for each in sets]
    with open_training_set(learned["set.h5"]) as reader:
        scene = reader.frame(0)
    assert isinstance(scene, TrainingFrame)
    level = np.float32(0.003 / (scene.electrons.mean() / table.camera.full_scale))
    signal = sensor.mosaic(scene.electrons, table.camera.cfa) * level / np.float32(table.camera.full_scale)
    target = scene.target * np.float32(level * scene.exposure / table.output_unit)
    for camera, best in ((table.camera, 0), (at_noise(table.camera, 0.1), 1)):
        values = expose_patches(signal, camera, np.random.default_rng(5)).astype(np.uint16)
        frame = RawFrame("dark", values, table.black_level, table.white_level)
        error = [float(np.mean((renderer.outputs(frame) - target)[1, 4:-4, 4:-4] ** 2)) for renderer in renderers]
        assert error[best] < 0.9 * error[1 - best]


def test_frames_without_a_filter_are_rendered_as_by_one_set(learned: dict[str, Path]) -> None:
    one, two = (load(TransformTable, learned[f"{name}.h5"]) for name in ("one", "two"))
    values = np.random.default_rng(1).integers(240, 900, (24, 40)).astype(np.uint16)
    frame = RawFrame("frame", values, one.black_level, one.white_level)
    renderer = NoiseRenderer("reference", two)
    np.testing.assert_array_equal(renderer.outputs(frame), NoiseRenderer("reference", one).outputs(frame))
    shares = np.full((6, 10), 1000, np.uint16)
    shares[:, 5:] = 150
    half = dataclasses.replace(frame, noise_share=0.5, noise_left=NoiseLeft(shares, 1000, (4, 4)))
    low = two.under(two.conditions[0])
    outputs, reach = renderer.outputs(half), 8
    isolated = [ReferenceRenderer(table).outputs(frame) for table in (one, low)]
    np.testing.assert_array_equal(outputs[:, :, : 20 - reach], isolated[0][:, :, : 20 - reach])
    np.testing.assert_array_equal(outputs[:, :, 20 + reach :], isolated[1][:, :, 20 + reach :])
    assert (isolated[0] != isolated[1]).any()


def test_cells_up_to_the_limit_are_of_low_noise() -> None:
    left = NoiseLeft(np.array([[353, 354], [355, 1000]], np.uint16), 1000, (2, 3))
    low, lower = NoiseScale(noise_left=0.25), NoiseScale(noise_left=0.125)
    limits = noise_limits(with_low_noise(random_table(BAYER), 0.125, 0.25))
    assert list(limits) == [low, lower]
    assert limits[low] == 0.25**0.75
    assert limits[lower] == pytest.approx(0.125**0.75 * 0.25**0.25)
    np.testing.assert_array_equal(left.below([0.354], (3, 5)), [[1, 1, 1, 1, 1], [1, 1, 1, 1, 1], [0, 0, 0, 0, 0]])
    np.testing.assert_array_equal(left.below([0.9, 0.3535], (3, 5)), [[2, 2, 2, 1, 1], [2, 2, 2, 1, 1], [1, 1, 1, 0, 0]])


@pytest.mark.parametrize("layers", [lambda table: with_refinement(table, 3, 5), with_tree])
def test_two_sets_are_written_and_read(layers: Callable[[TransformTable], TransformTable], tmp_path: Path) -> None:
    table = with_low_noise(layers(random_table(BAYER)))
    save(table, tmp_path / "table.h5")
    assert equal(load(TransformTable, tmp_path / "table.h5"), table)


def test_low_noise_transforms_of_other_layers_are_refused() -> None:
    table = with_low_noise(with_refinement(random_table(BAYER), 3))
    (low,) = table.conditions
    assert low.edges is not None

    def changed(message: str, **fields: Any) -> None:
        with pytest.raises(ValueError, match=message):
            dataclasses.replace(table, conditions=(dataclasses.replace(low, **fields),))

    changed("conditions/0 has 1 layers, but the table has 2", later=())
    changed("a condition must have", noise=None, edges=None)
    narrow = dataclasses.replace(low.later[0], weights=low.later[0].weights[:, :, :3])
    changed("the weights in conditions/0/later/0 have the shape .* but the weights in later/0 have", later=(narrow,))
    few = dataclasses.replace(low.first, weights=low.first.weights[..., :4])
    changed("axis tap has length 4 in conditions/0/first/weights", first=few)
    dark = dataclasses.replace(low.edges, contrast_edges=low.edges.contrast_edges[:, :2])
    changed("axis level has length 2 in conditions/0/edges/contrast_edges", edges=dark)
    scale = low.edges.gradients[0]
    short = GradientScale(scale.gradient_factor[:2], scale.gradient_shift[:2])
    changed("edges must have as many levels as the table", edges=dataclasses.replace(low.edges, gradients=(short,)))


def test_sums_for_low_noise_are_those_of_all_sites(bayer: CameraModel, tmp_path: Path) -> None:
    head, sums = some_sums(bayer)
    write_partial_sums(tmp_path / "one.h5", head, iter([sums]), iter([sums]))
    with open_partial_sums(tmp_path / "one.h5") as reader:
        assert reader.conditions == 1
        assert equal(reader.site(0, 1), sums)
    write_partial_sums(tmp_path / "less.h5", head, iter([sums]), iter([]))
    with pytest.raises(InputFileError, match="sums of one or more sites"), open_partial_sums(tmp_path / "less.h5"):
        pass
    layer, _ = some_layer_sums(bayer)
    with pytest.raises(ValueError, match="gradients must contain a GradientScale"):
        dataclasses.replace(layer, table=with_low_noise(layer.table))


def test_wrong_calls_are_one_line(learned: dict[str, Path], tmp_path: Path, refused: Refused) -> None:
    train = ("train", learned["set.h5"], "-o", tmp_path / "table.h5", "--classes")
    for key, words in (("1", "noise_left"), ("-0.1", "noise_left"), ('0.1\nnoise = "none"', "noise_left is 0.1")):
        (tmp_path / "classes.toml").write_text(f"[learning]\nnoise_left = {key}\n")
        assert words in refused(2, *train, tmp_path / "classes.toml")
