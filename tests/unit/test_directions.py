"""The class feature direction, the structure classes of refinement layers, and the chroma that shading would cause."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule, Feature, StoredFeatures
from l3cli.artifacts.plane_rules import DIRECTIONS, StructureRule
from l3cli.artifacts.schema import equal
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.classes import direction, structure
from l3cli.classes.decide import label_mosaic, label_patches
from l3cli.classes.features import ClassRecipe
from l3cli.classes.names import class_name
from l3cli.classes.planes import CHROMA
from l3cli.classes.refinement import RATIO_DARKEST, ROWS_AT_ONCE, bilateral_change, shaded_chroma
from l3cli.classes.rule import left_out, make_rule
from l3cli.classes.windows import neighbourhoods, sites
from l3cli.errors import InputFileError, RecipeError
from l3cli.frames.frame import RawFrame, pad_mosaic
from l3cli.rendering.conditions import with_edges_for
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.training.symmetry import IDENTITY_ONLY, orientations, stabilisers, turned_classes, turns_of
from tests.helpers.calls import L3
from tests.helpers.cameras import bayer_camera, random_camera
from tests.helpers.tables import XYZ, random_table, with_first

FOUR, EIGHT = direction.DirectionKeys(), direction.DirectionKeys(orientations=8, strengths=(3.0, 9.0), coherence=0.5)
BAYER = [[0, 1], [1, 2]]


def a_rule(camera: CameraModel, keys: direction.DirectionKeys, patch: int = 9) -> ClassRule:
    features: dict[str, Any] = {"direction": keys}
    return make_rule(ClassRecipe(patch=patch, **features), camera, np.zeros(2 ** len(camera.channels), np.uint16))


def directions(values: np.ndarray, rule: ClassRule, camera: CameraModel) -> np.ndarray:
    """Direction (row, col) of every pixel of a mosaic."""
    labels = label_mosaic(np.rint(values).clip(0, 4095).astype(np.uint16), rule, camera.cfa, len(camera.channels))
    return rule.split(labels).combination


@pytest.mark.parametrize("name", ["bayer", "fiveband"])
@pytest.mark.parametrize("degrees", range(0, 180, 15))
def test_a_ramp_varies_along_its_angle(name: str, degrees: int, request: pytest.FixtureRequest) -> None:
    """Of both signs; the share of the angle that is off is at most half a step of the orientations."""
    camera = request.getfixturevalue(name)
    row, col = np.mgrid[:40, :40] - 20
    along = col * np.cos(np.radians(degrees)) + row * np.sin(np.radians(degrees))
    for keys, slope in ((FOUR, 20), (EIGHT, -20)):
        rule = a_rule(camera, keys)
        seen = directions(1500 + slope * along, rule, camera)[18:22, 18:22]
        assert (seen > 0).all()
        size = keys.orientations
        angle = ((seen - 1) % size - (0.5 if size == 8 else 0)) * 180 / size
        assert np.abs((angle - degrees + 90) % 180 - 90).max() <= 90 / size + 3  # integers, and √2 in 1/64
        if keys is EIGHT:
            assert ((seen - 1) // size % 2 == 1).all()  # coherent


def test_noise_alone_is_flat_and_checks_are_not_coherent(bayer: CameraModel) -> None:
    rng = np.random.default_rng(0)
    rule = a_rule(bayer, EIGHT)
    span = bayer.white_level - bayer.black_level
    for share in (0.01, 0.1, 0.5):
        noise = rng.standard_normal((80, 80)) * np.sqrt(bayer.noise_variance(np.array(share * span)))
        seen = directions(bayer.black_level + share * span + noise, rule, bayer)
        assert (seen == 0).mean() > 0.95
    texture = rng.normal(1500, 700, (16, 16)).repeat(5, 0).repeat(5, 1)
    seen = directions(texture, rule, bayer)
    assert (seen > 0).mean() > 0.9
    assert 0.1 < ((seen[seen > 0] - 1) // 8 % 2 == 0).mean() < 0.9


@pytest.mark.parametrize("keys", [FOUR, EIGHT], ids=["4", "8"])
def test_mosaic_and_patches_are_labelled_alike(fiveband: CameraModel, keys: direction.DirectionKeys) -> None:
    rng = np.random.default_rng(2)
    rule = a_rule(fiveband, keys)
    values = rng.integers(100, 4096, (21, 26)).astype(np.uint16)
    labels = label_mosaic(values, rule, fiveband.cfa, 5, (1, 2))
    neighbours = neighbourhoods(fiveband.cfa, rule.patch, 5)
    padded = pad_mosaic(values, rule.radius, fiveband.cfa.shape)
    patches = np.lib.stride_tricks.sliding_window_view(padded, (9, 9)).reshape(*values.shape, -1)
    site = sites(21, 26, fiveband.cfa.shape, (1, 2))
    assert len(np.unique(rule.split(labels).combination)) > rule.combinations / 2
    for number in range(16):
        of_site = rule.on_site(label_patches(patches[site == number], rule, neighbours, number), number)
        np.testing.assert_array_equal(of_site, labels[site == number])


@pytest.mark.parametrize("keys", [FOUR, EIGHT], ids=["4", "8"])
@pytest.mark.parametrize("patch", [5, 9, 11])
def test_a_turned_patch_has_the_turned_direction(bayer: CameraModel, keys: direction.DirectionKeys, patch: int) -> None:
    """Of a monochrome camera, whose every orientation has the same window."""
    camera = dataclasses.replace(
        bayer,
        cfa=np.zeros((1, 1), np.uint8),
        channels=("g",),
        responsivity=bayer.responsivity[:1],
        responsivity_band=bayer.responsivity_band[:1],
    )
    for cfa in ((1, 1), (2, 2), (3, 3)):
        rule = a_rule(dataclasses.replace(camera, cfa=np.zeros(cfa, np.uint8)), keys, patch)
        neighbours = neighbourhoods(camera.cfa, patch, 1)
        patches = np.random.default_rng(1).integers(300, 4096, (500, patch**2)).astype(np.uint16)
        before = label_patches(patches, rule, neighbours, 0)
        for number, turn in enumerate(orientations(patch)):
            wrong = label_patches(patches[:, turn], rule, neighbours, 0) != turned_classes(rule, number)[before]
            assert wrong.mean() < 0.01  # ties, in which the first axis wins


def test_sums_are_averaged_over_all_turns_of_a_window_with_the_classes_they_turn_into(bayer: CameraModel) -> None:
    rule = a_rule(bayer, FOUR)
    neighbours = neighbourhoods(bayer.cfa, rule.patch, 3)
    turns = turns_of(rule, neighbours.channel[0])
    assert len(turns) == len(stabilisers(neighbours.channel[0], rule.patch)) == 8
    assert len(turns_of(rule, neighbours.channel[0], IDENTITY_ONLY)) == 1
    patches = np.random.default_rng(1).integers(300, 4096, (500, rule.patch**2)).astype(np.uint16)
    before = label_patches(patches, rule, neighbours, 0)
    for turn in turns:
        wrong = turn.classes[label_patches(patches[:, turn.taps], rule, neighbours, 0)] != before
        assert wrong.mean() < 0.01  # ties, in which the first axis wins


def test_half_the_noise_is_as_flat(bayer: CameraModel) -> None:
    """To the edges for a quarter of its variance, as the whole is to the camera's own."""
    rule = a_rule(bayer, direction.DirectionKeys(strengths=(1.0,)))
    quiet = dataclasses.replace(
        rule, features=StoredFeatures.of(tuple(direction.with_less_noise(each, 0.25) for each in rule.feature_list))
    )
    span, noise = bayer.white_level - bayer.black_level, np.random.default_rng(1).normal(size=(300, 300))
    level = 0.3 * span
    noise *= np.sqrt(bayer.noise_variance(np.full((1, 1), level), 0.0))
    flat = [
        (directions(bayer.black_level + level + factor * noise, of, bayer) == 0).mean()
        for factor, of in ((1.0, rule), (0.5, quiet), (0.5, rule))
    ]
    assert 0.05 < flat[0] < 0.6
    assert abs(flat[1] - flat[0]) < 0.02
    assert flat[2] > flat[0] + 0.2


def test_a_table_for_less_noise_has_lower_edges() -> None:
    """A quarter of the variance: half of every strength edge, rounded."""
    table = random_table(BAYER, patch=9, direction=FOUR)
    whole, quiet = (each.first.rule.feature_list[0].constants for each in (table, with_edges_for(table, 0.25)))
    np.testing.assert_array_equal(quiet[: direction.HEAD], whole[: direction.HEAD])
    assert np.abs(quiet[direction.HEAD :] - whole[direction.HEAD :] / 2).max() <= 0.5


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (direction.DirectionKeys(strengths=()), "one or more positive numbers"),
        (direction.DirectionKeys(strengths=(3.0, 2.0)), "increasing order"),
        (direction.DirectionKeys(strengths=(-1.0, 2.0)), "positive"),
    ],
)
def test_an_impossible_direction_is_refused(fiveband: CameraModel, keys: direction.DirectionKeys, message: str) -> None:
    with pytest.raises(RecipeError, match=message):
        a_rule(fiveband, keys)


@pytest.mark.parametrize(("rows", "columns", "fits"), [(4, 2, True), (2, 8, True), (3, 4, False), (8, 5, False)])
def test_a_large_array_does_without(rows: int, columns: int, fits: bool) -> None:
    camera = random_camera(np.arange(rows * columns).reshape(rows, columns) % 2, 2, 12, 0.0)
    assert [feature.name for feature in a_rule(camera, FOUR).feature_list] == ["direction"] * fits
    features: dict[str, Any] = {"direction": FOUR}
    assert left_out(ClassRecipe(patch=9, **features), camera) == ["direction"] * (not fits)


def test_training_reports_what_it_does_without(tmp_path: Path, l3: L3) -> None:
    camera, scenes, classes = (tmp_path / f"{name}.toml" for name in ("camera", "scenes", "classes"))
    camera.write_text(bayer_camera(pattern=("g r b", "b g r")))
    scenes.write_text('exposure_share = [0.8]\n[[scene]]\nsource = "dead leaves"\nsize = [32, 32]\ncount = 2\n')
    classes.write_text("[classes]\npatch = 5\n[classes.direction]\n[learning]\npatches = 500\nfirst_draws = 0\n")
    assert l3("simulate", scenes, "--camera", camera, "-o", tmp_path / "training.h5")[0] == 0
    code, _, err = l3("train", tmp_path / "training.h5", "--classes", classes, "-o", tmp_path / "table.h5")
    assert code == 0, err
    assert "the class feature direction is not used, because patches of 5×5 pixels are too small for this feature" in err


def with_feature(table: TransformTable, feature: Feature) -> TransformTable:
    assert table.first.rule.features is not None
    features = type(table.first.rule.features).of((feature,))
    return with_first(table, rule=dataclasses.replace(table.first.rule, features=features))


def test_a_table_keeps_its_direction(tmp_path: Path) -> None:
    table = random_table(BAYER, direction=EIGHT)
    save(table, tmp_path / "table.h5")
    again = load(TransformTable, tmp_path / "table.h5")
    assert equal(again, table)
    assert again.first.rule.feature_list[0].windows == table.first.rule.feature_list[0].windows
    names = {class_name(again, index).split(", ")[4] for index in range(again.first.rule.classes_per_site)}
    assert len(names) == again.first.rule.combinations == 33
    assert {"flat", "along 11.25° strength 2 coherent", "along 168.75° strength 1 mixed"} <= names


def test_a_damaged_direction_is_refused() -> None:
    """Before a kernel reads past its constants."""
    table = random_table(BAYER, direction=FOUR)
    (feature,) = table.first.rule.feature_list
    frame = RawFrame("f", np.zeros((9, 9), np.uint16), 0.0, 4095.0)
    for wrong in (
        feature._replace(constants=feature.constants[:-1]),
        feature._replace(constants=feature.constants[:3]),
        feature._replace(constants=np.append(feature.constants[:2], [5, *feature.constants[3:]]).astype(np.int32)),
        feature._replace(windows=feature.windows[:2]),
        feature._replace(name="unheard of"),
    ):
        with pytest.raises(InputFileError, match=r"\"direction\" is invalid|does not support|is damaged"):
            ReferenceRenderer(with_feature(table, wrong)).labels(frame)
    outside = feature.windows[0]._replace(top=4)
    with pytest.raises(ValueError, match="within the patch"):
        with_feature(table, feature._replace(windows=(outside,)))


def test_trained_turned_sites_read_one_another(pipeline: Path, tmp_path: Path, l3: L3) -> None:
    """The two green sites are each other's quarter turn: a turned mosaic gives there the turned outputs, which it does only
    if their directions turn with their patches."""
    recipe = tmp_path / "classes.toml"
    recipe.write_text(
        "[classes]\npatch = 5\nlevels = 4\nchromas = 1\n[classes.direction]\n[learning]\npatches = 8000\nfirst_draws = 0\n"
        "equal_response = false\n"
    )
    code, _, err = l3("train", pipeline / "training.h5", "--classes", recipe, "-o", tmp_path / "table.h5")
    assert code == 0, err
    assert "× 5 values of direction ×" in err
    code, out, _ = l3("info", tmp_path / "table.h5")
    assert "along 45°" in out
    table = load(TransformTable, tmp_path / "table.h5")
    assert table.outputs == XYZ
    assert table.first.rule.combinations == 5
    row, col = np.mgrid[:64, :64]
    values = (1200 + 800 * np.sin(0.4 * row + 0.1 * col)).astype(np.uint16)
    renderer = ReferenceRenderer(table)
    plain = renderer.exact_outputs(RawFrame("f", values, table.black_level, table.white_level))
    turned = renderer.exact_outputs(RawFrame("f", np.rot90(values), table.black_level, table.white_level, (1, 0)))
    green = (table.cfa == 1)[row % 2, col % 2]
    difference = np.abs(np.rot90(plain, axes=(1, 2)) - turned)[:, 2:-2, 2:-2]
    assert difference[:, np.rot90(green)[2:-2, 2:-2]].max() < 1e-6
    assert (
        len(
            np.unique(
                table.first.rule.split(
                    renderer.labels(RawFrame("f", values, table.black_level, table.white_level))
                ).combination
            )
        )
        > 2
    )


SIZE = 33


def rule_of(signs: list[tuple[int, int]]) -> StructureRule:
    return StructureRule(
        level_step=1,
        gradient_factor=np.array([64], np.uint8),
        gradient_shift=np.array([6], np.uint8),
        strength_edges=np.array([2 * structure.NOISE_TRACE], np.uint32),
        coherence=31,
        turns=np.array(signs, np.int8),
        cases=1,
    )


def structure_at_centre(picture: np.ndarray, signs: tuple[int, int] = (1, 1)) -> int:
    rows, cols = picture.shape
    level = np.zeros((rows - 2, cols - 2), np.int64)
    labels = structure.structures(
        picture.astype(np.int64), level, np.zeros((rows - 6, cols - 6), np.int64), rule_of([signs])
    )
    return int(labels[rows // 2 - 3, cols // 2 - 3])


def grating(angle: float, amplitude: float = 2000.0) -> np.ndarray:
    """Stripes across `angle` in radians, the direction of the gradient from the columns towards the rows."""
    row, col = np.mgrid[:SIZE, :SIZE] - SIZE // 2
    return np.rint(amplitude * np.sin((col * np.cos(angle) + row * np.sin(angle)) * 0.5))


@pytest.mark.parametrize("number", range(DIRECTIONS))
def test_each_direction_of_an_edge_is_another_class(number: int) -> None:
    assert structure_at_centre(grating(np.pi * number / DIRECTIONS)) == 2 + number


def test_noise_of_its_level_is_flat_and_corners_have_no_direction() -> None:
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((200, 200)) * structure.SIGMA / np.sqrt(2)  # differences have twice the variance
    level, site = np.zeros((198, 198), np.int64), np.zeros((194, 194), np.int64)
    labels = structure.structures(np.rint(noise).astype(np.int64), level, site, rule_of([(1, 1)]))
    assert np.mean(labels == 0) > 0.97
    dot = np.zeros((SIZE, SIZE))
    dot[SIZE // 2, SIZE // 2] = 30000
    assert structure_at_centre(dot) == 1


@given(st.integers(0, 7), st.floats(0, np.pi), st.integers(0, 2**32 - 1))
def test_a_turned_picture_has_the_class_of_the_unturned_one_where_the_turn_is_known(
    turn: int, angle: float, seed: int
) -> None:
    """A site whose window is read in the order orientations()[turn] sees its neighbourhood as its canonical site does."""
    noise = np.random.default_rng(seed).standard_normal((SIZE, SIZE)) * 100
    canonical = grating(angle) + np.rint(noise)
    seen = np.empty(SIZE * SIZE)
    seen[orientations(SIZE)[turn]] = canonical.ravel()
    signs = structure.turn_signs(orientations(3)[turn])
    assert structure_at_centre(seen.reshape(SIZE, SIZE), signs) == pytest.approx(structure_at_centre(canonical), abs=0)


SHAPE = (9, 12)


def planes_of(luminance: NDArray[np.floating], first: float, second: float) -> NDArray[np.float64]:
    """Planes (plane, row, col) of one colour, whose chroma is `first` and `second` times its luminance."""
    return np.stack([first * luminance, luminance, second * luminance])


def means(plane: NDArray[np.floating], side: int) -> NDArray[np.float64]:
    """Over side × side about the pixels that have all of it."""
    return np.lib.stride_tricks.sliding_window_view(plane, (side, side)).mean(axis=(-2, -1), dtype=np.float64)


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([3, 5, 7]),
    st.floats(-2, 2),
    st.floats(-2, 2),
    st.floats(RATIO_DARKEST, 2.0**20),
)
def test_of_one_colour_it_is_all_that_chroma_differs_by(
    seed: int, side: int, first: float, second: float, level: float
) -> None:
    """Whatever light falls on it, up to twice its mean."""
    luminance = level * (1.2 + np.random.default_rng(seed).random(SHAPE))
    planes = planes_of(luminance, first, second)
    reach = side // 2
    inside = np.s_[reach:-reach, reach:-reach]
    for made, plane in zip(shaded_chroma(planes, side), planes[[0, 2]], strict=True):
        np.testing.assert_allclose(made[inside], plane[inside] - means(plane, side), atol=1e-9 * level)


@given(st.integers(0, 2**32 - 1), st.integers(0, 3), st.booleans())
def test_it_turns_with_the_planes(seed: int, turns: int, mirrored: bool) -> None:
    planes = np.random.default_rng(seed).normal(0, 2000, (3, *SHAPE))

    def turned(values: NDArray[np.floating]) -> NDArray[np.floating]:
        return np.rot90(values[..., ::-1] if mirrored else values, turns, (1, 2))

    for taps in (shaded_chroma, bilateral_change):
        np.testing.assert_allclose(taps(turned(planes), 5), turned(taps(planes, 5)), atol=1e-8)


def test_flat_areas_and_greys_have_none() -> None:
    flat = planes_of(np.full(SHAPE, 5000.0), 0.3, -0.2)
    assert np.abs(shaded_chroma(flat, 5)).max() < 1e-9
    grey = planes_of(np.random.default_rng(0).random(SHAPE) * 5000, 0.0, 0.0)
    assert (shaded_chroma(grey, 5) == 0).all()


def test_it_is_never_more_than_the_mean_and_dark_planes_have_little() -> None:
    """A spark, and noise about nothing: what is divided by stays above RATIO_DARKEST, what is multiplied within one."""
    rng = np.random.default_rng(1)
    spark = np.full(SHAPE, 1000.0)
    spark[4, 5] = 1e6
    planes = planes_of(spark, 0.5, 0.5)
    assert shaded_chroma(planes, 5)[0, 4, 5] == means(planes[0], 5)[2, 3]
    dark = rng.normal(0, RATIO_DARKEST / 100, (3, *SHAPE))
    assert np.abs(shaded_chroma(dark, 5)).max() < np.abs(dark).max() / 10


def test_bilateral_chroma_is_the_mean_of_pixels_alike() -> None:
    """Of one side of an edge, however it lies: there is nothing to change. Where only chroma is noisy, less noise is left; a
    spark, which nothing is like, stays."""
    rng = np.random.default_rng(1)
    side = np.add.outer(np.arange(40), np.arange(50)) > 45
    planes = np.where(side, 9000.0, 3000.0) * np.array([0.4, 1, -0.2])[:, None, None]
    assert (bilateral_change(planes, 5) == 0).all()
    planes[CHROMA] += rng.normal(0, 600, (2, *side.shape))
    change = bilateral_change(planes, 5)
    for plane, by in zip(planes[CHROMA], change, strict=True):
        left = plane + by - np.where(side, 9000.0, 3000.0) * (0.4 if plane.mean() > 0 else -0.2)
        assert left.std() < 0.7 * 600
    planes[:, 20, 20] = 1e6
    assert np.abs(bilateral_change(planes, 5)[:, 20, 20]).max() == 0
    single = bilateral_change(planes.astype(np.float32), 5)
    np.testing.assert_allclose(single, bilateral_change(planes, 5), atol=1e-5 * 1e6)


def test_bilateral_chroma_of_tall_planes_is_that_of_their_parts() -> None:
    planes = np.random.default_rng(2).normal(0, 2000, (3, 2 * ROWS_AT_ONCE + 3, 9))
    part = bilateral_change(planes[:, ROWS_AT_ONCE - 5 :], 5)
    np.testing.assert_array_equal(bilateral_change(planes, 5)[:, ROWS_AT_ONCE:], part[:, 5:])
