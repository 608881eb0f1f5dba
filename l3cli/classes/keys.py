"""Keys in the [classes] section of a class recipe: the patch, and the features level, contrast, saturation and chroma."""

from typing import Annotated, Literal

import msgspec

from l3cli.artifacts.class_rule import MAX_CHROMAS
from l3cli.recipes.toml import Count, CountOrNone, Recipe


class BasicKeys(Recipe):
    """Recipe keys for the patch and for the features level, contrast, saturation and chroma."""

    patch: Count = 9  # side of the patch in pixels

    levels: Count = 20
    spacing: Literal["logarithmic", "linear"] = "logarithmic"  # spacing of the level edges
    lowest_level: float = 0.001  # upper edge of the darkest level, as a fraction of full scale
    highest_level: float = 0.95  # lower edge of the brightest level, as a fraction of full scale
    # level edges as fractions of full scale; if this key is set, `levels`, `spacing`, `lowest_level` and `highest_level`
    # have no effect
    level_edges: tuple[float, ...] | None = None

    contrasts: tuple[float, ...] = (1.4,)  # edges between contrasts, as √(variance of the values / noise variance)

    saturation: float = 0.985  # pixels at or above this fraction of full scale are saturated
    # a channel clips if one of its pixels within this distance, in pixels, is saturated
    saturation_radius: CountOrNone = 2
    max_cases: Count = 12  # largest number of saturation cases, including the case without clipped channels

    # number of chromas, including white, that are distinguished if no channel clips; with 0 or 1, all colours share a class
    # (docs/method.md#chroma)
    chromas: Annotated[int, msgspec.Meta(ge=0, le=MAX_CHROMAS)] = 9
    # whether neighbouring sites may assign a colour between two chromas to different chromas, which avoids seams in tables
    # with several layers (docs/method.md#dither)
    chroma_dither: bool = False
