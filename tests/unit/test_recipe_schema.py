"""JSON schemas of recipes: shipped recipes keep to them, wrong ones do not, and they agree with what recipes are read by."""

import copy
import json
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from l3cli.cli.schema import KINDS as OFFERED
from l3cli.recipes.faults import typed
from l3cli.stages.checking.kinds import KINDS, kind_of
from l3cli.stages.checking.schema import schema
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import bayer_camera
from tests.helpers.paths import CONFIGS
from tests.helpers.recipes import spoilt

jsonschema = pytest.importorskip("jsonschema")
SCHEMAS = {kind: schema(kind) for kind in KINDS}
VALIDATORS = {kind: jsonschema.Draft202012Validator(each) for kind, each in SCHEMAS.items()}
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
    return list(VALIDATORS[kind].iter_errors(content))


@pytest.mark.parametrize("kind", KINDS)
def test_it_is_a_schema(kind: str, l3: L3) -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMAS[kind])
    code, out, err = l3("schema", kind)
    assert (code, err) == (0, "")
    assert json.loads(out) == SCHEMAS[kind]
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
    ("measurements", 'base = "a.h5"\ndark = []\nwhite = []', "dark = []\n", ""),
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


@settings(max_examples=100, deadline=None)
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


def test_keys_have_their_meaning() -> None:
    responsivity = SCHEMAS["camera"]["$defs"]["ResponsivityRecipe"]["properties"]
    assert responsivity["per_energy"] == {
        "type": "boolean", "default": False, "description": "the curves are per watt, not per photon",
    }  # fmt: skip
    assert responsivity["peak_efficiency"]["description"].startswith("quantum efficiency e-/photon at the peak")
    classes = SCHEMAS["classes"]["$defs"]
    assert classes["ClassRecipe"]["properties"]["max_cases"]["description"].startswith("saturation patterns")
    assert classes["LayerRecipe"]["properties"]["leaves"]["description"].startswith("classes, of a tree")
    assert SCHEMAS["scenes"]["$defs"]["Skin"]["properties"]["scale"]["description"].startswith("pixels a sample")


def test_the_command_offers_every_kind(refused: Refused) -> None:
    assert [*OFFERED] == [*KINDS, "output"]
    assert 'did you mean "camera"?' in refused(2, "schema", "camra")
