"""Lights by name: one short line for an unknown one, and a list of all in the docs."""

import re

import numpy as np
import pytest

from l3cli.errors import RecipeError
from l3cli.physics import spectra
from tests.helpers.paths import ROOT

WAVELENGTH = np.arange(400.0, 701.0, 20.0)


@pytest.mark.parametrize(
    ("name", "cure"),
    [
        ("d65", 'did you mean "D65"'),
        ("LED B3", '"LED-B3"'),
        ("tungsten", "usual ones are A,"),
        ("x" * 500, "usual ones are A,"),
    ],
)
def test_an_unknown_light_is_one_short_line(name: str, cure: str) -> None:
    with pytest.raises(RecipeError, match="is unknown") as caught:
        spectra.illuminant(name, WAVELENGTH)
    line = str(caught.value)
    assert cure in line
    assert len(line) < 220
    assert f'documentation, "Lights", lists all {len(spectra.illuminant_names())}' in line


def test_the_usual_ones_are_lights() -> None:
    for name in re.findall(r"[A-Z0-9-]*\d+K?|\bA\b", spectra.USUAL_LIGHTS.replace("(a black body)", "")):
        assert spectra.illuminant(name, WAVELENGTH).min() > 0


def test_the_docs_list_all() -> None:
    text = (ROOT / "docs/commands.md").read_text()
    (bullet,) = re.findall(r"^\* \*\*Lights\*\*(.*?)^\* ", text, re.MULTILINE | re.DOTALL)
    listed = set()
    for first, last in re.findall(r"`([^`]+)`(?:…`([^`]+)`)?", bullet):
        stem, number = re.fullmatch(r"(.*?)(\d*)", first).groups()  # type: ignore[union-attr]
        listed |= {f"{stem}{n}" for n in range(int(number), int(last.removeprefix(stem)) + 1)} if last else {first}
    known = {name.removeprefix("ISO 7589 ") for name in spectra.illuminant_names()}
    assert listed >= known
    assert listed - known == {*(f"F{n}" for n in range(1, 13)), '"3200K"', '"D6000K"', "ISO 7589"}
