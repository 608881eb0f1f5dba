"""Keys of [classes] in a class recipe for the features of every rule. The modules of the features explain them."""

from typing import Annotated, Literal

import msgspec

from l3cli.artifacts.class_rule import MAX_CHROMAS
from l3cli.recipes.toml import Count, CountOrNone, Recipe


class BasicKeys(Recipe):
    """Keys for the patch and for level, contrast, saturation and chroma."""

    patch: Count = 9  # pixels; side of the neighbourhood

    levels: Count = 20
    spacing: Literal["logarithmic", "linear"] = "logarithmic"  # spacing of the level edges
    lowest_level: float = 0.001  # upper edge of the darkest level, as a fraction of full scale
    highest_level: float = 0.95  # lower edge of the brightest level, as a fraction of full scale
    level_edges: tuple[float, ...] | None = None  # level edges as fractions of full scale; replace the four keys above

    contrasts: tuple[float, ...] = (1.4,)  # edges between contrasts: √(signal variance / noise variance)

    saturation: float = 0.985  # fraction of full scale at which a pixel counts as saturated
    saturation_radius: CountOrNone = 2  # pixels; saturation is tested up to this distance from the centre
    max_cases: Count = 12  # largest number of saturation patterns with their own classes, including the unsaturated pattern

    # number of colours, including white, that are distinguished without saturation; 0 or 1 for none (docs/method.md#chroma)
    chromas: Annotated[int, msgspec.Meta(ge=0, le=MAX_CHROMAS)] = 9
    # whether colours between two chromas are dithered, which avoids seams in tables with several layers
    chroma_dither: bool = False
