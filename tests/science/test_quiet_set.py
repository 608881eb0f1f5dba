"""A second set of transforms for less noise: what it is learned for, what it leaves alone, who renders by it."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.partial_sums import QUIET, open_partial_sums, write_partial_sums
from l3cli.artifacts.schema import equal
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingFrame, open_training_set
from l3cli.errors import InputFileError
from l3cli.frames.frame import NoiseLeft, RawFrame
from l3cli.rendering.quiet import quiet_renderer
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.simulation import sensor
from l3cli.training.patches import expose_patches
from l3cli.training.quiet import FilteredCamera
from tests.helpers.artifacts import some_layer_sums, some_sums
from tests.helpers.cameras import BAYER
from tests.helpers.paths import CONFIGS
from tests.helpers.tables import XYZ, random_table, with_later, with_quiet, with_tree

LEAVES = 'exposure_share = [0.9]\n[[scene]]\nsource = "dead leaves"\nsize = [64, 64]\ncount = 4\n'
CLASSES = "[classes]\npatch = 3\nlevels = 4\nchromas = 2\n[classes.direction]\n[learning]\npatches = 2000\nfirst_draws = 1\n"
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


def test_noise_over_time_falls_and_what_pixels_differ_by_stays(bayer: CameraModel) -> None:
    dark = 3.0
    whole, filtered = bayer.noise_terms(dark), FilteredCamera.of(bayer, 0.25).noise_terms(dark)
    still = dataclasses.replace(bayer, noise=dataclasses.replace(bayer.noise, dsnu=0.0, prnu=0.0, column_noise=0.0))
    moving, span = still.noise_terms(dark), bayer.white_level - bayer.black_level
    rounding = (span / (span - dark)) ** 2 / 12
    assert whole[0] - filtered[0] == pytest.approx(0.75 * (moving[0] - rounding))
    assert whole[1] - filtered[1] == pytest.approx(0.75 * moving[1])
    assert whole[2] == filtered[2]


def test_the_usual_set_is_what_it_would_be_alone(learned: dict[str, Path]) -> None:
    """The quiet one decides by lower edges."""
    one, two = (load(TransformTable, learned[f"{name}.h5"]) for name in ("one", "two"))
    assert equal(dataclasses.replace(two, quiet=None), one)
    assert one.quiet is None
    assert two.quiet is not None
    assert two.quiet.noise_left == 0.1
    usual, quiet = two.first.rule, two.quiet.first.rule
    assert (quiet.contrast_edges <= usual.contrast_edges).all()
    assert (quiet.contrast_edges[:, :2] < 0.5 * usual.contrast_edges[:, :2]).all()  # darkest: noise that varies in time
    edges, lower = (rule.axes[0].constants[5:] for rule in (usual, quiet))
    assert (lower < edges).all()


def test_each_set_is_best_at_the_noise_that_it_is_learned_for(learned: dict[str, Path]) -> None:
    """Of a dark scene with all of its camera's noise, and with a tenth of what varies in time."""
    table = load(TransformTable, learned["two.h5"])
    assert table.quiet is not None
    assert table.camera is not None
    sets = [table, dataclasses.replace(table, first=table.quiet.first, later=table.quiet.later, quiet=None)]
    renderers = [ReferenceRenderer(each) for each in sets]
    with open_training_set(learned["set.h5"]) as reader:
        scene = reader.frame(0)
    assert isinstance(scene, TrainingFrame)
    level = np.float32(0.003 / (scene.electrons.mean() / table.camera.full_scale))
    signal = sensor.mosaic(scene.electrons, table.camera.cfa) * level / np.float32(table.camera.full_scale)
    target = scene.target * np.float32(level * scene.exposure / table.output_unit)
    for camera, best in ((table.camera, 0), (FilteredCamera.of(table.camera, 0.1), 1)):
        values = expose_patches(signal, camera, np.random.default_rng(5)).astype(np.uint16)
        frame = RawFrame("dark", values, table.black_level, table.white_level)
        error = [float(np.mean((renderer.outputs(frame) - target)[1, 4:-4, 4:-4] ** 2)) for renderer in renderers]
        assert error[best] < 0.9 * error[1 - best]


def test_frames_without_a_filter_are_rendered_as_by_one_set(learned: dict[str, Path]) -> None:
    one, two = (load(TransformTable, learned[f"{name}.h5"]) for name in ("one", "two"))
    values = np.random.default_rng(1).integers(240, 900, (24, 40)).astype(np.uint16)
    frame = RawFrame("frame", values, one.black_level, one.white_level)
    renderer = quiet_renderer("reference", two)
    np.testing.assert_array_equal(renderer.outputs(frame), quiet_renderer("reference", one).outputs(frame))
    shares = np.full((6, 10), 1000, np.uint16)
    shares[:, 5:] = 150
    half = dataclasses.replace(frame, noise_share=0.5, noise_left=NoiseLeft(shares, 1000, (4, 4)))
    assert two.quiet is not None
    quiet = dataclasses.replace(two, first=two.quiet.first, later=two.quiet.later, quiet=None)
    outputs, reach = renderer.outputs(half), 8
    isolated = [ReferenceRenderer(table).outputs(frame) for table in (one, quiet)]
    np.testing.assert_array_equal(outputs[:, :, : 20 - reach], isolated[0][:, :, : 20 - reach])
    np.testing.assert_array_equal(outputs[:, :, 20 + reach :], isolated[1][:, :, 20 + reach :])
    assert (isolated[0] != isolated[1]).any()


def test_cells_up_to_the_limit_are_quiet() -> None:
    left = NoiseLeft(np.array([[353, 354], [355, 1000]], np.uint16), 1000, (2, 3))
    quiet = with_quiet(random_table(BAYER), noise_left=0.125).quiet
    assert quiet is not None
    assert quiet.limit == pytest.approx(0.2102, abs=1e-4)
    np.testing.assert_array_equal(left.quiet(0.354, (3, 5)), [[1, 1, 1, 1, 1], [1, 1, 1, 1, 1], [0, 0, 0, 0, 0]])
    np.testing.assert_array_equal(left.quiet(0.3535, (3, 5)), [[1, 1, 1, 0, 0], [1, 1, 1, 0, 0], [0, 0, 0, 0, 0]])


@pytest.mark.parametrize("layers", [lambda table: with_later(table, 3, 5), with_tree])
def test_two_sets_are_written_and_read(layers: Callable[[TransformTable], TransformTable], tmp_path: Path) -> None:
    table = with_quiet(layers(random_table(BAYER)))
    save(table, tmp_path / "table.h5")
    assert equal(load(TransformTable, tmp_path / "table.h5"), table)


def test_a_table_of_pictures_alone_keeps_both_sets() -> None:
    table = with_quiet(random_table(BAYER, outputs=(*XYZ, "N"))).pictured()
    assert table.outputs == XYZ
    assert table.quiet is not None
    assert table.quiet.first.weights.shape == table.first.weights.shape


def test_a_quiet_set_of_other_classes_is_refused() -> None:
    table = with_quiet(with_later(random_table(BAYER), 3))
    quiet = table.quiet
    assert quiet is not None
    assert quiet.later[0].structure is not None

    def changed(message: str, **fields: Any) -> None:
        with pytest.raises(ValueError, match=message):
            dataclasses.replace(table, quiet=dataclasses.replace(quiet, **fields))

    rule, structure = quiet.first.rule, quiet.later[0].structure
    other_levels = dataclasses.replace(rule, level_edges=rule.level_edges + np.uint32(1))
    changed("noise_left is 1, not", noise_left=1.0)
    changed("quiet holds 1 layers, the table 2", later=())
    changed("quiet/first has other classes", first=dataclasses.replace(quiet.first, rule=other_levels))
    coarser = dataclasses.replace(structure, coherence=structure.coherence + 1)
    changed("quiet/later/0 has other classes", later=(dataclasses.replace(quiet.later[0], structure=coarser),))
    narrow = dataclasses.replace(quiet.later[0], weights=quiet.later[0].weights[:, :, :3])
    changed("windows or transforms of other shapes", later=(narrow,))


def test_sums_of_a_quiet_set_of_other_classes_are_refused(bayer: CameraModel, tmp_path: Path) -> None:
    head, sums = some_sums(bayer)
    dark = dataclasses.replace(head.rule, contrast_edges=head.rule.contrast_edges // 2)
    write_partial_sums(tmp_path / "one.h5", dataclasses.replace(head, quiet_rule=dark), iter([sums]), iter([sums]))
    with open_partial_sums(tmp_path / "one.h5") as reader:
        assert equal(reader.head.quiet_rule, dark)
        assert equal(reader.site(0, QUIET), sums)
    write_partial_sums(tmp_path / "less.h5", dataclasses.replace(head, quiet_rule=dark), iter([sums]), iter([]))
    with pytest.raises(InputFileError, match="lacks sums of some sites"), open_partial_sums(tmp_path / "less.h5"):
        pass
    other = dataclasses.replace(head.rule, shift=head.rule.shift + 1)
    with pytest.raises(ValueError, match="quiet_rule has other classes"):
        dataclasses.replace(head, quiet_rule=other)
    layer, _ = some_layer_sums(bayer)
    assert layer.structure is not None
    coarser = dataclasses.replace(layer.structure, coherence=layer.structure.coherence + 1)
    with pytest.raises(ValueError, match="the quiet set's rule has other classes"):
        dataclasses.replace(layer, table=with_quiet(layer.table), quiet_structure=coarser)
    with pytest.raises(ValueError, match="either a structure rule or a tree"):
        dataclasses.replace(layer, table=with_quiet(layer.table))


def test_wrong_calls_are_one_line(learned: dict[str, Path], tmp_path: Path, refused: Callable) -> None:
    train = ("train", learned["set.h5"], "-o", tmp_path / "table.h5", "--classes")
    for key, words in (("1", "noise_left"), ("-0.1", "noise_left"), ('0.1\nnoise = "none"', "no noise to leave")):
        (tmp_path / "classes.toml").write_text(f"[learning]\nnoise_left = {key}\n")
        assert words in refused(2, *train, tmp_path / "classes.toml")
