"""Recipes: types of all keys, all faults reported together with file, key, table and line, and JSON schemas."""

import copy
import functools
import gc
import inspect
import json
import tomllib
from pathlib import Path
from typing import Annotated, Any, cast

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import CameraRecipe, camera_files, load_camera, recipe_text
from l3cli.cli.schema import KINDS as OFFERED
from l3cli.errors import InputFileError, RecipeError
from l3cli.io.curves import write_curves
from l3cli.io.measurement_recipe import MeasurementRecipe
from l3cli.recipes import schema as recipes_schema
from l3cli.recipes.faults import about_others, example, fault, typed
from l3cli.recipes.key_lines import key_lines, line_of
from l3cli.recipes.load import load_recipe
from l3cli.recipes.toml import KeyPath, Recipe, parse_toml, toml_key, toml_value
from l3cli.simulation.lab import LabRecipe
from l3cli.simulation.recipe import SceneRecipe
from l3cli.spectra.file import read_table
from l3cli.stages.check import KINDS, kind_of, schema
from l3cli.training.recipe import TrainingRecipe
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import bayer_camera
from tests.helpers.paths import CONFIGS
from tests.helpers.recipes import spoilt

SCENES = """
illuminants = ["D65", 3]
exposure_share = 0.9
[lens]
diffraction = 1
[sensor]
noise = "al"
analog_gain = 1e9
[[scene]]
source = "dead leaves"
size = [160, 0]
cont = 3
[[scene]]
source = "dead leavs"
[[scene]]
source = "cube"
file = "x"
wavelengths_nm = [1, "a"]
"""
PHOTO = 'name = "x"\n[photo]\nframes = ["a", 1]\nlayout = [4]\n[[white]]\n[[white]]\nframes = ["a"]\nexposure_s = "1"\n'


@pytest.mark.parametrize(
    ("recipe", "text", "keys"),
    [
        (
            SceneRecipe,
            SCENES,
            "illuminants.1 exposure_share lens.diffraction sensor.noise sensor.analog_gain scene.0.size.1 scene.0.cont "
            "scene.1.source scene.2.wavelengths_nm.1",
        ),
        (MeasurementRecipe, PHOTO, "photo.frames.1 photo.layout white.0.frames white.1.exposure_s sensor cfa optics"),
        (
            TrainingRecipe,
            '[classes]\npatch = 0\ncontrasts = [1, "a"]\n[classes.direction]\nx = 1\n[[layer]]\n[[layer]]\nside = 11',
            "classes.patch classes.contrasts.1 classes.direction.x layer.1.side",
        ),
        (LabRecipe, "falloff = nan\n[mono]\nradiance = -1\n[dark]\ntrials = true", "falloff mono.radiance dark.trials"),
    ],
)
def test_every_wrong_key_is_reported_once(recipe: type[Recipe], text: str, keys: str) -> None:
    usable, faults = typed(parse_toml(text, "x"), recipe)
    assert usable is not None
    assert sorted(each.keys[0] for each in faults) == sorted(fault("", key).keys[0] for key in keys.split())


@pytest.mark.parametrize("recipe", [CameraRecipe, LabRecipe, SceneRecipe, TrainingRecipe, MeasurementRecipe])
def test_examples_are_of_their_type(recipe: type[Recipe]) -> None:
    msgspec.convert(example(recipe), recipe)


@pytest.mark.parametrize("least", [0, 1, 5.5])
def test_an_example_of_a_number_is_above_its_limit(least: float) -> None:
    kind = Annotated[float, msgspec.Meta(gt=least)]
    assert msgspec.convert(example(kind), kind) > least


DAMAGED: list[tuple[str, type[Recipe]]] = [
    ("cameras/fiveband", CameraRecipe),
    ("scenes/default", SceneRecipe),
    ("classes/best", TrainingRecipe),
    ("lab/default", LabRecipe),
]
OTHERS: list[Any] = [-1, 0, 1.5, 1e30, "x", [], {}, [1, "a"], {"a": 1}, True, None]


def damaged(content: Any, draw: Any) -> Any:
    """A recipe's content with some values replaced, left out, or under another name."""
    if isinstance(content, dict):
        inner = {key: damaged(value, draw) for key, value in content.items()}
        return {draw(st.sampled_from([key] * 12 + [key + "x"])): value for key, value in inner.items() if value is not None}
    if isinstance(content, list):
        return [value for each in content if (value := damaged(each, draw)) is not None]
    return draw(st.sampled_from([content] * 40 + OTHERS))


@settings(max_examples=40, deadline=None)
@given(st.data(), st.sampled_from(DAMAGED))
def test_what_is_refused_first_is_among_all_that_is_refused(data: st.DataObject, kind: tuple[str, type[Recipe]]) -> None:
    name, recipe = kind
    content = damaged(parse_toml((CONFIGS / f"{name}.toml").read_text(), name), data.draw)
    usable, faults = typed(content, recipe)
    try:
        same = msgspec.convert(content, recipe)
    except msgspec.ValidationError:
        assert faults
    else:
        assert not [each for each in faults if "null character" not in each.message and "within ±" not in each.message]
        assert faults or usable == same  # a number that is too large is replaced by an example
    assert usable is not None


def test_what_follows_from_a_fault_is_no_other_one() -> None:
    known = [fault("no number", "sensor.bits"), fault("unknown", "scene.1.x")]
    others = [
        fault("a", "sensor.rows"),
        fault("b", "sensor.rows", "sensor.bits"),
        fault("c", "scene.0"),
        fault("d", "scene.1"),
    ]
    assert [each.message for each in about_others(others, known)] == ["a", "c"]


def paths(content: Any, path: KeyPath = ()) -> set[KeyPath]:
    """Every key, table and entry of what tomllib has read."""
    inner = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    return {path}.union(*(paths(value, (*path, key)) for key, value in inner)) - {()}


NAMES = st.one_of(
    st.text("ab_-1", min_size=1, max_size=3), st.sampled_from(['"a.b"', "'#'", '"\\u0041\\n"', '"[x]"', "'='", '""'])
)
SCALARS = st.sampled_from([
    "1", "-2.5e3", "true", "1979-05-27 07:32:00", "1979-05-27T07:32:00Z", "inf", '"a # b"', "'c = [1'", '"\\"}"',
    '"""x\ny"""', '"""a""b\\""""', "'''\n[t]\nk = 1\n'''", '""', "''", '""""a"""""', "''''b'''''", '"""\\\n  z"""',
])  # fmt: skip
BLANKS = st.sampled_from(["", " ", "\t"])
BREAKS = st.sampled_from(["", " ", "\n", ' # ] } "\n', "\n\n"])


@st.composite
def lists(draw: st.DrawFn, values: st.SearchStrategy[str]) -> str:
    items = [draw(BREAKS) + each + draw(BREAKS) for each in draw(st.lists(values, max_size=3))]
    return f"[{','.join(items)}{draw(st.sampled_from(['', ','])) if items else ''}{draw(BREAKS)}]"


@st.composite
def inline_tables(draw: st.DrawFn, values: st.SearchStrategy[str]) -> str:
    return "{" + ", ".join(f"{draw(keys())} = {each}" for each in draw(st.lists(values, max_size=3))) + draw(BLANKS) + "}"


@st.composite
def keys(draw: st.DrawFn) -> str:
    return f"{draw(BLANKS)}.{draw(BLANKS)}".join(draw(st.lists(NAMES, min_size=1, max_size=3)))


TEXTS = st.recursive(SCALARS, lambda values: lists(values) | inline_tables(values), max_leaves=6)


@st.composite
def texts(draw: st.DrawFn) -> str:
    """Statements of TOML, many of which contradict each other."""
    lines = []
    for _ in range(draw(st.integers(0, 7))):
        kind, key = draw(st.sampled_from("tap")), draw(keys())
        statement = {"t": f"[{key}]", "a": f"[[{key}]]"}.get(kind) or f"{key} = {draw(TEXTS)}"
        lines.append(
            draw(BLANKS) + statement + draw(st.sampled_from(["", "  # [no]", " "])) + draw(st.sampled_from(["\n", "\n\n"]))
        )
    return "".join(lines)


@settings(max_examples=100, deadline=None)
@given(texts())
def test_every_key_that_tomllib_reads_has_a_line(text: str) -> None:
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return
    assert set(key_lines(text)) == paths(content)
    assert key_lines(text.replace("\n", "\r\n")) == key_lines(text)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(["k", "t", "a", "d"]), TEXTS, BREAKS), max_size=8))
def test_a_key_is_in_the_line_where_it_is_written(parts: list[tuple[str, str, str]]) -> None:
    text, entries = "", 0
    table: KeyPath = ()
    expected: dict[KeyPath, int] = {}
    for number, (kind, value, gap) in enumerate(parts):
        text += gap + "\n"
        line = text.count("\n") + 1
        if kind == "t":
            table, text = (f"t{number}",), text + f"[t{number}]\n"
            expected[table] = line
        elif kind == "a":
            table, text, entries = ("list", entries), text + "[[list]]\n", entries + 1
            expected[table] = line
        elif kind == "d":
            text += f"d{number}.'in' . side = {value}\n"
            expected[*table, f"d{number}", "in", "side"] = line
        else:
            text += f'"k{number}" = [\n  {value},\n]\n'
            expected[*table, f"k{number}"], expected[*table, f"k{number}", 0] = line, line + 1
    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError:  # of a comment without its end, or two equal keys of a table
        return
    found = key_lines(text)
    assert {path: found[path] for path in expected} == expected


@pytest.mark.parametrize("path", sorted(CONFIGS.rglob("*.toml")), ids=lambda path: path.stem)
def test_shipped_recipes(path: Path) -> None:
    text = path.read_text()
    lines, shown = key_lines(text), text.splitlines()
    assert set(lines) == paths(tomllib.loads(text))
    named = {path: line for path, line in lines.items() if isinstance(path[-1], str)}
    assert all(str(path[-1]) in shown[line - 1] for path, line in named.items())


def test_what_is_missing_is_where_it_ought_to_be() -> None:
    lines = key_lines('name = "x"\n[a]\nb = 1\n[[c]]\nd = 2\n[[c]]\n[c.e]\nf = { g = 3 }\n')
    assert line_of(("a", "b"), lines) == 3
    assert line_of(("a", "missing"), lines) == 2
    assert line_of(("c", 1, "e", "f", "g"), lines) == 8
    assert line_of(("c", 1, "d"), lines) == 6
    assert line_of(("missing", 3, "d"), lines) == 1


jsonschema = pytest.importorskip("jsonschema")
schema_of = functools.cache(schema)
RECIPES = sorted(path for path in CONFIGS.rglob("*.toml") if path.parent.name != "priors")
MEASURED = bayer_camera().partition("[responsivity]")[0] + "[optics]\nfocal_length_mm = 25\nf_number = 2.8\n"
MEASURED = MEASURED.replace("gain_dn_per_e = 0.25\nblack_level_dn = 64\nfixed_pattern_seed = 3\n", "")
MEASURED += """[[mono]]
frames = ["a.tif"]
exposure_ms = 3
spectrum = "a.csv"
column = 2
[[chart]]
frames = ["b.tif"]
exposure_s = 0.1
illuminant = "D65"
corners = [[1, 2], [3.5, 4], [5, 6], [7, 8]]
radiance = "c.csv"
[photo]
frames = ["c.dng"]
layout = [4, 6]
"""


def problems(kind: str, content: Any) -> list[Any]:
    return list(jsonschema.Draft202012Validator(schema_of(kind)).iter_errors(content))


@pytest.mark.parametrize("kind", KINDS)
def test_it_is_a_schema(kind: str, l3: L3) -> None:
    jsonschema.Draft202012Validator.check_schema(schema_of(kind))
    code, out, err = l3("schema", kind)
    assert (code, err) == (0, "")
    assert json.loads(out) == schema_of(kind)
    assert "null" not in out
    assert "prefixItems" not in out  # which older dialects do not know
    assert out.isascii()


@pytest.mark.parametrize("path", RECIPES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_shipped_recipes_keep_to_it(path: Path) -> None:
    content = tomllib.loads(path.read_text())
    kind = kind_of(content)
    assert kind is not None
    assert problems(kind.name, content) == []


WRONG = [
    ("camera", bayer_camera(), "bits = 12", "bits = 1.5"),
    ("camera", bayer_camera(), "bits = 12", "bits = 12\nbitz = 3"),
    ("camera", bayer_camera(), "rows = 192\n", ""),
    ("camera", bayer_camera(), "[400, 700, 10]", "[400, 700]"),
    ("camera", bayer_camera(), "fixed_pattern_seed = 3", "fixed_pattern_seed = -3"),
    ("camera", 'name = "x"\nbase = "y.toml"\nphase = [0, 1]', "[0, 1]", "[0, -1]"),
    ("measurements", MEASURED, "exposure_ms = 3", 'exposure_ms = "3"'),
    ("measurements", MEASURED, "[5, 6], [7, 8]", "[5, 6, 7], [7, 8]"),
    ("measurements", MEASURED, "[4, 6]", "[0, 6]"),
    ("measurements", 'base = "a.h5"\n[[dark]]\nframes = ["a"]\n[[white]]\nframes = ["b"]', "[[dark]]", "[[darks]]"),
    ("lab", "[mono]\nradiance = 1e18", "1e18", "0"),
    ("lab", "[chart]\ntrials = 1", "trials = 1", "trials = 0"),
    ("scenes", '[[scene]]\nsource = "skin"\nsize = [16, 16]', "skin", "skinn"),
    ("scenes", '[[scene]]\nsource = "skin"\nsize = [16, 16]', "[16, 16]", "[16]"),
    ("scenes", '[[scene]]\nsource = "skin"\nsize = [16, 16]\nrotate = 90', "90", "45"),
    ("scenes", 'sensor.noise = "shot"', "shot", "shots"),
    ("classes", "[classes]\npatch = 5", "patch = 5", "patch = 0"),
    ("classes", "[learning]\nlevel_power = 0.5", "0.5", "1.5"),
    ("classes", "[classes.direction]\norientations = 4", "= 4", "= 5"),
]


@pytest.mark.parametrize(("kind", "text", "old", "new"), WRONG)
def test_a_wrong_recipe_does_not(kind: str, text: str, old: str, new: str) -> None:
    assert old in text
    assert problems(kind, tomllib.loads(text)) == []
    assert problems(kind, tomllib.loads(text.replace(old, new)))


@settings(max_examples=60, deadline=None)
@given(st.data(), st.sampled_from([path for path in RECIPES if "benchmarks" not in path.parts]))
def test_it_agrees_with_what_recipes_are_read_by(data: st.DataObject, path: Path) -> None:
    whole = tomllib.loads(path.read_text())
    kind = kind_of(whole)
    assert kind is not None
    content = spoilt(copy.deepcopy(whole), data.draw)
    if kind.name == "camera" and ("base" in content) != ("base" in whole):
        return
    _, faults = typed(content, kind.structure(content))
    assert bool(problems(kind.name, content)) == bool(faults)


def test_the_command_offers_every_kind(refused: Refused) -> None:
    assert [*OFFERED] == [*KINDS]
    assert 'did you mean "camera"?' in refused(2, "schema", "camra")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name = "small Bayer"', "", "missing key `name` at the top level"),
        ('"g b"', '"g b b"', "rows of cfa.pattern have different lengths"),
        ("wavelength_nm = [400, 700, 10]", "wavelength_nm = [700, 400, 10]", "first < last"),
        ("black_level_dn = 64", "black_level_dn = 5000", "black level is 5000"),
        ("black_level_dn = 64", "black_dn = 64", 'unknown key `black_dn` in [sensor]; did you mean "black_level_dn"?'),
    ],
)
def test_a_wrong_recipe_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = bayer_camera()
    assert old in text
    path = tmp_path / "camera.toml"
    path.write_text(text.replace(old, new))
    with pytest.raises(RecipeError) as caught:
        load_camera(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)


PHASE = 'name = "shifted"\nbase = "whole.toml"\nphase = [1, 0]\n'


def test_a_camera_recipe_is_another_one_from_another_pixel_on(tmp_path: Path) -> None:
    whole, path = tmp_path / "whole.toml", tmp_path / "camera.toml"
    whole.write_text(bayer_camera())
    path.write_text(PHASE)
    camera, base = load_camera(path), load_camera(whole)
    assert camera.name == "shifted"
    np.testing.assert_array_equal(camera.cfa, np.roll(base.cfa, -1, axis=0))
    np.testing.assert_array_equal(camera.responsivity, base.responsivity)
    assert camera_files(path) == [path, whole]
    assert recipe_text(path) == PHASE + "\n" + bayer_camera()
    path.write_text(PHASE.replace("[1, 0]", "[1, 1]"))
    np.testing.assert_array_equal(load_camera(path).cfa, np.roll(base.cfa, (-1, -1), axis=(0, 1)))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[1, 0]", "[0, 2]", "phase is [0, 2], but the array in"),
        ("[1, 0]", "[-1, 0]", "use at least 0"),
        ("phase = [1, 0]", "", "missing key `phase` at the top level"),
        ("phase", "bits = 3\nphase", "unknown key `bits` at the top level"),
        ("whole.toml", "camera.toml", "unknown key `base` at the top level"),
        ("whole.toml", "none.toml", "none.toml does not exist"),
    ],
)
def test_a_wrong_base_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    (tmp_path / "whole.toml").write_text(bayer_camera())
    (tmp_path / "camera.toml").write_text(PHASE.replace(old, new))
    with pytest.raises((RecipeError, InputFileError)) as caught:
        load_camera(tmp_path / "camera.toml")
    assert message in str(caught.value)


def test_a_recipe_that_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "camera.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputFileError, match="not a text file"):
        load_recipe(path, CameraRecipe)


def test_the_fiveband_recipe_is_the_camera_of_method_1_1() -> None:
    camera = load_camera(CONFIGS / "cameras/fiveband.toml")
    assert (camera.rows, camera.cols, camera.bits) == (1164, 2048, 12)
    names = np.array(camera.channels)[camera.cfa]
    assert [" ".join(row) for row in names] == ["b g c g", "g o g r", "c g b g", "g r g o"]
    assert np.bincount(camera.cfa.ravel()).tolist() == [2, 8, 2, 2, 2]
    assert camera.black_level / 4095 == pytest.approx(0.0266, abs=1e-4)
    peaks = camera.wavelength[camera.responsivity.argmax(axis=1)]
    assert np.abs(peaks - [615, 535, 440, 565, 515]).max() <= 10


def test_the_parametric_responsivities_meet_the_measured_ones(fiveband: CameraModel, l3_data: Path) -> None:
    import json

    published = json.loads((l3_data / "sensitivities/fiveband_camera.json").read_text())
    measured = np.array(published["filterSpectra_photon_relative"]).T
    measured = measured / measured.max()
    grid = np.array(published["wavelength_nm"], dtype=float)
    ours = np.array([np.interp(grid, fiveband.wavelength, curve) for curve in fiveband.responsivity])
    ours = ours / ours.max()
    assert np.sqrt(np.mean((ours - measured) ** 2, axis=1)).max() < 0.03
    assert np.sqrt(np.mean((ours - measured) ** 2)) < 0.017  # configs/cameras/fiveband.toml says 1.4 %
    assert published["cfa_pattern_1based"] == (fiveband.cfa + 1).tolist()


@pytest.mark.parametrize("name", ['a"\nb = 1', "\x7f\x1b[31m", "\\", "'", "a.b", "#", "ü漢\U0001f600", ""])
def test_any_name_is_written_so_that_it_is_read_again(name: str) -> None:
    text = f"{toml_key(name)} = {toml_value([name, {name: 1.5}])}\n"
    assert tomllib.loads(text) == {name: [name, {name: 1.5}]}


def test_bytes_that_are_no_text_are_replaced() -> None:
    assert toml_value("a\udcff").encode() == b'"a?"'


def test_names_of_curves_come_back_whatever_they_hold(tmp_path: Path) -> None:
    names = ("a,b", 'say "g"', "b")
    write_curves(tmp_path / "curves.csv", np.array([400.0, 500.0, 600.0]), np.eye(3), names)
    assert read_table(tmp_path / "curves.csv").names == names


def test_structures_of_one_name_are_told_apart_by_their_modules() -> None:
    one, other = (
        msgspec.defstruct("Options", [(key, int, 1)], bases=(Recipe,), module=f"package.{key}") for key in ("one", "other")
    )
    both = msgspec.defstruct("Both", [("first", one | None, None), ("second", other | None, None)], bases=(Recipe,))
    tables = recipes_schema.schema_of((cast("type[Recipe]", both),), "both")["$defs"]
    assert [list(tables[f"package.{key}.Options"]["properties"]) for key in ("one", "other")] == [["one"], ["other"]]


def test_nothing_is_collected_where_nested_lists_exhaust_the_stack() -> None:
    """Finalizers that run there fail, and Python prints their errors."""
    depths, thresholds = [], gc.get_threshold()

    def collecting(phase: str, _: dict[str, int]) -> None:
        frame, depth = inspect.currentframe(), 0
        while frame is not None:
            frame, depth = frame.f_back, depth + 1
        depths.append(depth)

    gc.callbacks.append(collecting)
    gc.set_threshold(10)
    try:
        with pytest.raises(RecipeError, match="too deeply"):
            parse_toml("a = " + "[" * 5000 + "]" * 5000, "odd.toml")
        gc.collect()
    finally:
        gc.callbacks.remove(collecting)
        gc.set_threshold(*thresholds)
    assert gc.isenabled()
    assert depths
    assert max(depths) < 300
