"""Numbers of the classes of a layer that reads planes, whatever distinguishes them."""

from typing import Any, NamedTuple

import numpy as np


class PlanePlace(NamedTuple):
    """Places of classes along the axes of their rule: integers, or integer arrays of equal shape."""

    site: Any  # CFA row · CFA columns + CFA column
    level: Any
    kind: Any  # structure of an unsaturated pixel, or structures − 1 + saturation case of one near saturation


class PlaneClasses:
    """class = (site · levels + level) · kinds + kind. Level and saturation case are those of the first layer; structures are
    what a rule tells apart where nothing is saturated."""

    cases: int  # saturation cases of the first layer, the unsaturated one included

    @property
    def levels(self) -> int:
        raise NotImplementedError

    @property
    def structures(self) -> int:
        raise NotImplementedError

    @property
    def kinds(self) -> int:
        return self.structures + self.cases - 1

    @property
    def classes_per_site(self) -> int:
        return self.levels * self.kinds

    def level_of(self, first: Any) -> Any:
        """Return the levels of this rule for levels of the first layer."""
        raise NotImplementedError

    def join(self, level: Any, kind: Any, site: Any = 0) -> Any:
        """Return the indices of classes from their places; `level` is one of this rule."""
        return (site * self.levels + level) * self.kinds + kind

    def split(self, index: Any) -> PlanePlace:
        """Return the places of the classes `index`, an integer or an array."""
        rest, kind = divmod(index, self.kinds)
        site, level = divmod(rest, self.levels)
        return PlanePlace(site, level, kind)

    def within_site(self, index: Any) -> tuple[Any, Any]:
        """Return the sites of the classes `index` of all sites, and their indices within them."""
        site, within = divmod(index, self.classes_per_site)
        return site, within

    def kind(self, structure: Any, case: Any) -> Any:
        """Return the kinds of pixels of a structure and a saturation case, which decides where it is not 0."""
        return np.where(np.greater(case, 0), self.structures - 1 + case, structure)

    def case(self, kind: Any) -> Any:
        """Return the saturation cases of kinds: 0 where nothing is saturated and the kind is a structure."""
        return np.maximum(kind - self.structures + 1, 0)
