"""Small recipes that require much work: deep keys, many entries, many errors, and globs that match everything.

Choices are drawn as in hostile_spoiling.py.
"""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass

from l3cli.recipes.faults import LISTED
from tests.helpers.hostile import Workshop, verdict
from tests.helpers.hostile_spoiling import Choices, one_of

HEAD = 'exposure_share = [0.9]\nilluminants = ["D65"]\n'
SCENE = '[[scene]]\nsource = "rgb"\n'
SHAPES: dict[str, Callable[[int], str]] = {  # of about so many letters
    "dotted key": lambda size: "a" + ".a" * (size // 2) + " = 1\n",
    "dotted quoted key": lambda size: '"a"' + '."a"' * (size // 4) + " = 1\n",
    "dotted heading": lambda size: "[" + "a." * (size // 2) + "a]\n",
    "deep keys": lambda size: "".join("a." * 100 + f"k{at} = 1\n" for at in range(size // 200)),
    "lists in lists": lambda size: f"a = {'[' * (size // 2)}{']' * (size // 2)}\n",
    "tables in tables": lambda size: f"a = {'{a = ' * (size // 6)}1{'}' * (size // 6)}\n",
    "empty scenes": lambda size: HEAD + "[[scene]]\n" * (size // 10),
    "unknown keys of scenes": lambda size: HEAD + (SCENE + 'file = "x"\nz = 1\n') * (size // 40),
    "scenes of nothing": lambda size: HEAD + (SCENE + 'file = "x*"\n') * (size // 40),
    "unknown keys": lambda size: HEAD + "".join(f"k{at} = 1\n" for at in range(size // 10)),
    "unknown tables": lambda size: HEAD + "".join(f"[k{at}]\n" for at in range(size // 10)),
    "wrong values": lambda size: HEAD + "luminances_cd_m2 = [" + '"x", ' * (size // 5) + "]\n",
    "a long key": lambda size: HEAD + SCENE + "z" * size + " = 1\n",
    "a long number": lambda size: f"{HEAD}{SCENE}field_of_view_deg = 0x{'f' * size}\n",
    "one light": lambda size: "exposure_share = [0.9]\nilluminants = [" + '"D6000K",' * (size // 9) + "]\n" + SCENE,
    "no numbers": lambda size: HEAD + "luminances_cd_m2 = [" + "nan, " * (size // 5) + "]\n",
    "lights that are none": lambda size: "exposure_share = [0.9]\nilluminants = [" + '"zz", ' * (size // 6) + "]\n" + SCENE,
    "glob of everything": lambda size: f"{HEAD}{SCENE}file = '{'/*' * min(size // 2, 100)}'\n",
}  # fmt: skip


@dataclass(frozen=True)
class LargeRecipes:
    """Draws recipes of several shapes and sizes and runs `l3 check` on them."""

    name: str = "large recipes"
    often: int = 1

    def draw(self, choices: Choices) -> tuple[str, int]:
        """Draw a shape and a size."""
        return one_of(choices, list(SHAPES)), choices.integer(1000, 200_000)

    def judge(self, shop: Workshop, drawn: tuple[str, int]) -> str | None:
        """Return what went wrong, or None."""
        path = shop.inputs / "recipe.toml"
        path.write_text(SHAPES[drawn[0]](drawn[1]))
        try:
            with contextlib.chdir(shop.inputs):
                return verdict(["check", path.name], codes=(3,), lines=LISTED + 1)
        finally:
            path.write_bytes(shop.recipe)
