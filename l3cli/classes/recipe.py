"""What a class recipe may say of classes."""

from typing import Annotated, Literal

import msgspec

from l3cli.artifacts.class_rule import MAX_CHROMAS
from l3cli.config import Count, CountOrNone, Recipe


class ClassRecipe(Recipe):
    """How pixels are sorted into classes (configs/classes)."""

    patch: Count = 9  # pixels, side of the neighbourhood
    levels: Count = 20
    spacing: Literal["logarithmic", "linear"] = "logarithmic"  # of the level edges, between …
    lowest_level: float = 0.001  # … the upper edge of the darkest level, share of full scale …
    highest_level: float = 0.95  # … and the lower edge of the brightest
    level_edges: tuple[float, ...] | None = None  # shares of full scale, in place of the four keys above
    contrasts: tuple[float, ...] = (1.4,)  # edges of √(signal variance / noise variance)
    saturation: float = 0.985  # share of full scale from which a pixel is saturated
    saturation_radius: CountOrNone = 2  # pixels
    chromas: Annotated[int, msgspec.Meta(ge=0, le=MAX_CHROMAS)] = (
        8  # colours told apart where nothing is saturated; 0 or 1: none (docs/method.md#chroma)
    )
    max_cases: Count = 12  # saturation patterns that get classes of their own, the unsaturated one included
