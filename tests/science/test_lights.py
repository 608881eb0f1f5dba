"""Transforms for single illuminants: training frames, mixtures for a white, and the commands that use them."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from l3cli.artifacts.schema import equal
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import open_training_set
from l3cli.evaluation.evaluation import raw_of
from l3cli.physics import spectra
from l3cli.physics.correlated_lights import mired_of
from l3cli.rendering.conditions import Mix, described, mix_for, mixed, nearest_for
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.stages.evaluation import FrameRenderers, warn_of_other_lights
from l3cli.system.console import Silent
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import BAYER
from tests.helpers.paths import CONFIGS
from tests.helpers.tables import XYZ, random_table, with_lights, with_refinement, with_tree

LEAVES = 'illuminants = {}\nexposure_share = [0.5]\n[[scene]]\nsource = "dead leaves"\nsize = [48, 48]\ncount = 2\n'
CLASSES = "[classes]\npatch = 3\nlevels = 2\nchromas = 2\n[learning]\npatches = 600\nfirst_draws = 0\ndraws = 2\n"
LAYER = "[[layer]]\nside = 3\nmosaics = 4\nrows = 200\n"


@pytest.fixture(scope="module")
def learned(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A table of one set of transforms, and one of a set for each of two lights besides, of the same training sets."""
    from l3cli.cli import run

    folder = tmp_path_factory.mktemp("lights")
    camera = CONFIGS / "cameras/bayer.toml"
    calls: list[tuple[Any, ...]] = []
    for name, lights in (("both", '["D65", "A"]'), ("warm", '["A"]')):
        (folder / f"{name}.toml").write_text(LEAVES.format(lights))
        calls.append(("simulate", folder / f"{name}.toml", "--camera", camera, "-o", folder / f"{name}.set.h5"))
    light, noise = 'lights = ["A", "D65"]\n', "noise_left = 0.1\n"
    for name, key in (("one", ""), ("several", light), ("product", light + noise)):
        (folder / f"{name}.classes.toml").write_text(CLASSES + key + LAYER)
        classes = ("--classes", folder / f"{name}.classes.toml")
        calls.append(("train", folder / "both.set.h5", folder / "warm.set.h5", *classes, "-o", folder / f"{name}.h5"))
    for call in calls:
        assert run([*map(str, call), "--quiet"]) == 0
    return {path.name: path for path in folder.iterdir()}


@pytest.fixture(scope="module")
def several(learned: dict[str, Path]) -> TransformTable:
    return load(TransformTable, learned["several.h5"])


def white(light: str) -> np.ndarray:
    return spectra.white_point(light)


# ------------------------------------------------------------------------------------------------------- learning


def test_transforms_in_common_are_what_they_would_be_alone(learned: dict[str, Path], several: TransformTable) -> None:
    assert equal(mixed(several, None), load(TransformTable, learned["one.h5"]))
    assert [light.name for light in several.lights] == ["A", "D65"]
    for light in several.lights:
        np.testing.assert_allclose(light.white_point, white(light.name), rtol=2e-3)
        assert light.spectrum is not None
        assert light.spectrum.spread < 1e-6


def test_lights_at_each_noise_are_those_of_a_table_of_lights(learned: dict[str, Path], several: TransformTable) -> None:
    both = load(TransformTable, learned["product.h5"])
    keys = [(each.light and each.light.name, each.noise and each.noise.shot) for each in both.conditions]
    assert keys == [(None, 0.1), ("A", None), ("A", 0.1), ("D65", None), ("D65", 0.1)]
    assert [each.noise for each in mixed(both, None).conditions] == [both.conditions[0].noise]
    assert equal(dataclasses.replace(both, conditions=both.conditions[1::2]), several)
    under_a = both.lights[0].white_point
    lit = mixed(both, mix_for(both, under_a))
    assert equal(dataclasses.replace(lit, conditions=()), mixed(several, mix_for(several, under_a)))
    np.testing.assert_array_equal(lit.conditions[0].first.weights, both.conditions[2].first.weights)
    assert [each.light for each in lit.conditions] == [None]


def test_each_set_is_best_under_its_light(learned: dict[str, Path], several: TransformTable) -> None:
    """It is learned from the frames under it, in whatever set they lie."""
    renderers = {
        light.name: ReferenceRenderer(mixed(several, mix_for(several, light.white_point))) for light in several.lights
    }
    errors: dict[tuple[str, str], list[float]] = {}
    with open_training_set(learned["both.set.h5"]) as reader:
        for index, frame in enumerate(reader):
            target = frame.target * np.float32(frame.exposure / several.output_unit)
            for name, renderer in renderers.items():
                error = renderer.outputs(raw_of(frame, index, reader.head.camera)) - target
                errors.setdefault((frame.illuminant, name), []).append(float(np.mean(error[:, 4:-4, 4:-4] ** 2)))
    for light, other in (("A", "D65"), ("D65", "A")):
        assert np.mean(errors[light, light]) < 0.8 * np.mean(errors[light, other])


@pytest.mark.usefixtures("same_workers")
def test_a_set_does_not_depend_on_how_the_work_is_divided(learned: dict[str, Path], tmp_path: Path, l3: L3) -> None:
    call = ("train", learned["both.set.h5"], learned["warm.set.h5"], "--classes", learned["several.classes.toml"])
    assert l3(*call, "-o", tmp_path / "two.h5", "--jobs", "2", "--quiet")[0] == 0
    assert (tmp_path / "two.h5").read_bytes() == learned["several.h5"].read_bytes()


def test_wrong_calls_are_one_line(learned: dict[str, Path], tmp_path: Path, refused: Refused) -> None:
    def train(name: str, *more: Any) -> tuple[Any, ...]:
        return ("train", learned[f"{name}.set.h5"], "-o", tmp_path / "table.h5", "--classes", *more)

    assert "learning.lights" in refused(3, *train("warm", learned["several.classes.toml"]))
    path, text = tmp_path / "classes.toml", learned["several.classes.toml"].read_text()
    for key, words in (
        ('lights = ["A"]', "learning.lights must list at least two illuminants"),
        ('lights = ["A", "A"]', "only once"),
    ):
        path.write_text(text.replace('lights = ["A", "D65"]', key))
        assert words in refused(2, *train("both", path))
    assert "learning.lights" in refused(2, *train("both", learned["several.classes.toml"], "--shard", "1/2"))
    export = ("export", learned["one.h5"], "-o", tmp_path / "export", "--to", "folder", "--white", "A")
    assert "--white" in refused(2, *export)


# --------------------------------------------------------------------------------------------------------- mixing


@pytest.mark.parametrize("layers", [lambda table: with_refinement(table, 3, 5), with_tree])
def test_the_lights_themselves_and_all_beyond_have_their_own_transforms(
    layers: Callable[[TransformTable], TransformTable],
) -> None:
    table = with_lights(layers(random_table(BAYER)), "D65", "A", "4000K")
    for scene, own in (("A", 1), ("2000K", 1), ("4000K", 2), ("D65", 0), ("D20000K", 0)):
        mix = mix_for(table, white(scene))
        made, of_light = mixed(table, mix), table.conditions[own]
        for ours, theirs in zip(made.layers, table.under(of_light).layers, strict=True):
            np.testing.assert_array_equal(ours.weights, theirs.weights)
            np.testing.assert_array_equal(ours.intercept, theirs.intercept)
        light = table.lights[own]
        np.testing.assert_array_equal(made.white_point, light.white_point)
        assert made.light is not None
        assert light.spectrum is not None
        np.testing.assert_array_equal(made.light.radiance, light.spectrum.radiance)
        assert mix is not None
        assert described(table, mix) == light.name
    assert not mixed(table, mix).conditions


def test_between_lights_transforms_are_mixed_by_mired() -> None:
    table = with_lights(with_refinement(random_table(BAYER), 3), "D65", "A", "4000K")
    mix = mix_for(table, white("3200K"))
    assert mix is not None
    warm, cool, scene = (mired_of(white(light)) for light in ("A", "4000K", "3200K"))
    assert (mix.warm, mix.cool) == (1, 2)
    assert mix.share == pytest.approx((warm - scene) / (warm - cool))
    assert described(table, mix) == "62 % A, 38 % 4000K"
    share = np.float32(mix.share)
    for ours, one, other in (
        (mixed(table, mix).first, table.conditions[1].first, table.conditions[2].first),
        (mixed(table, mix).later[0], table.conditions[1].later[0], table.conditions[2].later[0]),
    ):
        np.testing.assert_allclose(ours.weights, one.weights + share * (other.weights - one.weights), rtol=1e-5, atol=1e-6)
    assert nearest_for(table, white("3200K")) == Mix(1, 2, 0.0)
    assert nearest_for(table, white("3700K")) == Mix(1, 2, 1.0)
    again = dataclasses.replace(table, conditions=table.conditions[::-1])
    assert equal(mixed(again, mix_for(again, white("3200K"))), mixed(table, mix))


def test_lights_are_written_and_read(tmp_path: Path) -> None:
    table = with_lights(with_refinement(random_table(BAYER), 3, 5), "A", "D65")
    save(table, tmp_path / "table.h5")
    assert equal(load(TransformTable, tmp_path / "table.h5"), table)
    shown = with_lights(random_table(BAYER, outputs=(*XYZ, "N")), "A", "D65").pictured()
    assert mixed(shown, mix_for(shown, white("A"))).first.weights.shape == shown.first.weights.shape


def test_lights_of_other_classes_are_refused() -> None:
    table = with_lights(with_refinement(random_table(BAYER), 3), "A", "D65")
    warm, cool = table.conditions
    narrow = dataclasses.replace(cool.later[0], weights=cool.later[0].weights[:, :, :3])
    for message, fields in (
        ("conditions/1 has 1 layers, but the table has 2", {"later": ()}),
        ("the weights in conditions/1/later/0 have the shape", {"later": (narrow,)}),
        ("conditions must be grouped by illuminant", {"light": warm.light}),
    ):
        with pytest.raises(ValueError, match=message):
            dataclasses.replace(table, conditions=(warm, dataclasses.replace(cool, **fields)))


# ------------------------------------------------------------------------------------------------------ rendering


def test_frames_are_judged_by_the_transforms_of_their_light(learned: dict[str, Path], several: TransformTable) -> None:
    renderers = FrameRenderers("reference", several, Silent())
    with open_training_set(learned["both.set.h5"]) as reader:
        for frame in reader:
            own = next(each for each in several.conditions if each.light and each.light.name == frame.illuminant)
            np.testing.assert_allclose(renderers.of(frame).table.first.weights, own.first.weights, atol=1e-3)


@pytest.mark.parametrize(("trained", "warned"), [(("D65",), True), (("A", "D65"), False)])
def test_a_baseline_that_wins_under_a_light_of_no_training_is_named(trained: tuple[str, ...], warned: bool) -> None:
    table = dataclasses.replace(random_table(BAYER), white_point=white("D65"), light=None)
    table = with_lights(table, *trained) if len(trained) > 1 else table
    errors = {"ours": {"mean_delta_e": 7.0}, "basic": {"mean_delta_e": 6.0}}
    groups = [{"illuminant": light, **errors} for light in ("A", "D65")]
    document = {"pipelines": ["ours", "basic"], "by_illuminant": groups}
    said: list[str] = []

    class Listener(Silent):
        def warn(self, message: str) -> None:
            said.append(message)

    warn_of_other_lights(table, document, {light: 100 * white(light) for light in ("A", "D65")}, Listener())
    assert len(said) == warned
    assert all("basic under A" in line and "D65" not in line for line in said)
