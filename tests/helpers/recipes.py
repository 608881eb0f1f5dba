"""Recipes for scenes and classes with which simulation and training take seconds, and invalid recipes."""

import json
import re
from collections.abc import Callable
from typing import Any

from hypothesis import strategies as st

from tests.helpers.paths import CONFIGS

SCENES = """
exposure_share = [0.9]
[[scene]]
source = "dead leaves"
size = [96, 96]
count = 10
"""
UNSEEN = """
exposure_share = [0.8]
[[scene]]
source = "composition"
size = [160, 240]
seed = 5
"""
THREE_SCENES = """
[[scene]]
source = "composition"
size = [320, 480]
seed = 7
[[scene]]
source = "dead leaves"
size = [320, 480]
[[scene]]
source = "surfaces"
size = [320, 480]
"""
CLASSES = "[classes]\npatch = 5\nlevels = 8\nchromas = 3\n[learning]\npatches = 5000\ndraws = 4\n"
FEW_CLASSES = "[classes]\npatch = 5\nlevels = 4\nchromas = 1\n[learning]\npatches = 300\nfirst_draws = 0\n"
SMALL = {
    "scenes": 'exposure_share = [0.9]\n[[scene]]\nsource = "dead leaves"\nsize = [64, 64]\ncount = 4\n',
    "unseen": 'exposure_share = [0.9]\n[[scene]]\nsource = "composition"\nsize = [96, 144]\nseed = 5\n',
    "classes": "[classes]\npatch = 5\nlevels = 6\nlowest_level = 0.02\nchromas = 3\nmax_cases = 4\n"
    "[learning]\npatches = 2000\ndraws = 4\nfirst_draws = 0\n",
}
GAIN_CLASSES = (
    "[classes]\npatch = 3\nlevels = 8\nchromas = 2\n[classes.direction]\n[learning]\npatches = 4000\nfirst_draws = 1\n"
)
VALUES: list[Any] = [-1, 0, 2, 1.25, 1e9 + 0.5, "x", "D65", [], {}, [1, 2], [[1, 2]], True, {"peak": 1}]  # all types


def spoilt(content: Any, draw: Callable[..., Any]) -> Any:
    """Replace or remove one value of a recipe, chosen by Hypothesis."""
    if isinstance(content, dict) and content:
        key = draw(st.sampled_from(sorted(content)))
        if draw(st.integers(0, 5)) == 0:
            return {name: value for name, value in content.items() if name != key}
        return content | {key: spoilt(content[key], draw)}
    if isinstance(content, list) and content and draw(st.integers(0, 3)):
        at = draw(st.integers(0, len(content) - 1))
        return [*content[:at], spoilt(content[at], draw), *content[at + 1 :]]
    if isinstance(content, float) and draw(st.booleans()):
        return content * draw(st.sampled_from([-1, 0, 0.001, 1000]))
    return draw(st.sampled_from(VALUES))


def as_toml(content: dict[str, Any]) -> str:
    """Format a recipe as TOML with one line per key."""
    return "".join(f"{json.dumps(key)} = {_value(value)}\n" for key, value in content.items())


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {_value(inner)}" for key, inner in value.items()) + "}"
    return "[" + ", ".join(map(_value, value)) + "]" if isinstance(value, list) else json.dumps(value)


def small_classes(name: str = "default") -> str:
    """Return a class recipe with fewer patches and levels."""
    text = (CONFIGS / f"classes/{name}.toml").read_text()
    smaller = {"levels": 3, "patches": 600, "draws": 2, "first_draws": 1, "mosaics": 8, "plain_surfaces": 2, "patch": 5}
    for name, value in smaller.items():
        text, count = re.subn(rf"(?m)^{name} = [\d.]+", f"{name} = {value}", text)
        assert count == 1
    return text
