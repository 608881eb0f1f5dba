"""All that the declared types refuse of a recipe, at once."""

from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from l3cli.artifacts.camera_recipe import CameraRecipe
from l3cli.errors import RecipeError
from l3cli.io.measurement_recipe import MeasurementRecipe
from l3cli.recipes.faults import about_others, example, fault, typed
from l3cli.recipes.toml import Recipe, parse_recipe, parse_toml
from l3cli.simulation.lab_recipe import LabRecipe
from l3cli.simulation.recipe import SceneRecipe
from l3cli.training.recipe import TrainingRecipe
from tests.helpers.cameras import bayer_camera
from tests.helpers.paths import CONFIGS

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
PHOTO = 'name = "x"\n[photo]\nframes = ["a", 1]\nlayout = [4]\n[[white]]\n[[white]]\nframes = []\nexposure_s = "1"\n'


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
def test_every_wrong_key_is_told_once(recipe: type[Recipe], text: str, keys: str) -> None:
    usable, faults = typed(parse_toml(text, "x"), recipe)
    assert usable is not None
    assert sorted(each.keys[0] for each in faults) == sorted(fault("", key).keys[0] for key in keys.split())


def test_messages_are_those_of_the_first_error() -> None:
    text = bayer_camera()
    for old, new in (("bits = 12", "bits = 1.5"), ("rows = 192", "rowz = 192"), ("prnu = 0.005", 'prnu = "1 %"')):
        wrong = text.replace(old, new)
        with pytest.raises(RecipeError) as caught:
            parse_recipe(wrong, CameraRecipe, "x")
        assert str(caught.value).partition(": ")[2] in [
            each.message for each in typed(parse_toml(wrong, "x"), CameraRecipe)[1]
        ]


@pytest.mark.parametrize("recipe", [CameraRecipe, LabRecipe, SceneRecipe, TrainingRecipe, MeasurementRecipe])
def test_examples_are_of_their_type(recipe: type[Recipe]) -> None:
    msgspec.convert(example(recipe), recipe)


KINDS: list[tuple[str, type[Recipe]]] = [
    ("cameras/fiveband", CameraRecipe),
    ("scenes/default", SceneRecipe),
    ("classes/best", TrainingRecipe),
    ("lab/default", LabRecipe),
]
VALUES: list[Any] = [-1, 0, 1.5, 1e30, "x", [], {}, [1, "a"], {"a": 1}, True, None]


def damaged(content: Any, draw: Any) -> Any:
    """A recipe's content with some values replaced, left out, or under another name."""
    if isinstance(content, dict):
        inner = {key: damaged(value, draw) for key, value in content.items()}
        return {draw(st.sampled_from([key] * 12 + [key + "x"])): value for key, value in inner.items() if value is not None}
    if isinstance(content, list):
        return [value for each in content if (value := damaged(each, draw)) is not None]
    return draw(st.sampled_from([content] * 40 + VALUES))


@settings(max_examples=70, deadline=None)
@given(st.data(), st.sampled_from(KINDS))
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
        assert usable == same
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
