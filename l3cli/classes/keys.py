"""Keys of [classes] in a class recipe that define the features of every class rule.

The modules level, contrast, saturation and chroma explain the features.
"""

from typing import Annotated, Literal

import msgspec

from l3cli.artifacts.class_rule import MAX_CHROMAS
from l3cli.recipes.toml import Count, CountOrNone, Recipe


class BasicKeys(Recipe):
    """Keys that define the patch and the features level, contrast, saturation and chroma."""

    patch: Count = 9  # pixels; side of the neighbourhood

    levels: Count = 20
    spacing: Literal["logarithmic", "linear"] = "logarithmic"  # spacing of the level edges
    lowest_level: float = 0.001  # upper edge of the darkest level, as a fraction of full scale
    highest_level: float = 0.95  # lower edge of the brightest level, as a fraction of full scale
    # level edges as fractions of full scale; they replace the four keys above
    level_edges: tuple[float, ...] | None = None

    contrasts: tuple[float, ...] = (1.4,)  # edges between contrasts, as √(variance of the values / variance of the noise)

    saturation: float = 0.985  # fraction of full scale from which a pixel counts as saturated
    saturation_radius: CountOrNone = 2  # pixels; a channel clips if it has a saturated pixel within this distance
    max_cases: Count = 12  # largest number of saturation cases, including the case in which no channel clips

    # number of colours, including white, that are distinguished if nothing clips; with 0 or 1, colours are not distinguished
    # (docs/method.md#chroma)
    chromas: Annotated[int, msgspec.Meta(ge=0, le=MAX_CHROMAS)] = 9
    # whether pixels whose colour is between two chromas alternate between them, which avoids seams in tables with several
    # layers
    chroma_dither: bool = False
