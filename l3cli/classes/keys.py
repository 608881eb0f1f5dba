"""Keys of the [classes] of a recipe that are about the features of every rule; each feature's module explains its own."""

from typing import Annotated, Literal

import msgspec

from l3cli.artifacts.class_rule import MAX_CHROMAS
from l3cli.recipes.toml import Count, CountOrNone, Recipe


class BasicKeys(Recipe):
    """Keys of patch, level, contrast, saturation and chroma."""

    patch: Count = 9  # pixels, side of the neighbourhood

    levels: Count = 20
    spacing: Literal["logarithmic", "linear"] = "logarithmic"  # of the level edges
    lowest_level: float = 0.001  # upper edge of the darkest level, as a fraction of full scale
    highest_level: float = 0.95  # lower edge of the brightest level, as a fraction of full scale
    level_edges: tuple[float, ...] | None = None  # as fractions of full scale; replaces the four keys above

    contrasts: tuple[float, ...] = (1.4,)  # edges of √(signal variance / noise variance)

    saturation: float = 0.985  # fraction of full scale from which a pixel counts as saturated
    saturation_radius: CountOrNone = 2  # pixels
    max_cases: Count = 12  # saturation patterns with their own classes, including the unsaturated pattern

    # number of colours distinguished where nothing is saturated, including white; 0 or 1: none (docs/method.md#chroma)
    chromas: Annotated[int, msgspec.Meta(ge=0, le=MAX_CHROMAS)] = 9
    # whether CFA sites between two chromas are divided among them, which avoids seams in tables of several layers
    chroma_dither: bool = False
