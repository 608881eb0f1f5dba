"""The first layer's class rule, as stored in tables, and the conversion between feature values and class indices.

docs/method.md#classes defines the classes. Each module in l3cli/classes computes one feature and explains its values.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.schema import check, data, group

MAX_COMBINATIONS = 4096  # maximum number of combinations of additional feature values
MAX_WINDOW_TAPS = 4096  # maximum number of taps in all windows together; sums of 12-bit values are then exact in float32
CLASS_BITS = 12  # classes depend only on the upper 12 bits of a value, so that sums are exact in 32 bits
CHROMA_SCALE = 1 << 10  # represents a chroma weight of 1, small enough for sums over 16 channels to fit into 32 bits
MAX_CHROMAS = 64
MAX_PATCH = 15


class Window(NamedTuple):
    """A rectangle in a patch. Its pixels are added to, or subtracted from, a sum from which a feature is computed."""

    sum: int  # index of the sum to which the pixels contribute
    top: int
    left: int
    rows: int
    columns: int
    sign: int  # 1 or −1


class Feature(NamedTuple):
    """The stored definition of an additional feature, such as the direction."""

    name: str  # key in the class recipe, and name of the module that computes the feature
    size: int  # number of possible values
    windows: tuple[Window, ...]  # windows of all sums, which are numbered from 0
    constants: NDArray[np.int32]  # constants in the formula of the feature

    @property
    def sums(self) -> int:
        """Number of window sums from which the feature is computed, or 0 if it has no windows."""
        return 1 + max((window.sum for window in self.windows), default=-1)


@dataclass(frozen=True)
class StoredFeatures:
    """The additional features of a class rule, converted to arrays for storage.

    The index that encodes the values of all features depends on the order of the features.
    """

    names: tuple[str, ...] = data("str", "feature", doc="names of the features, as in the recipe")
    sizes: NDArray[np.int64] = data("int64", "feature", doc="number of values of each feature")
    window_counts: NDArray[np.int64] = data("int64", "feature", doc="number of windows of each feature")
    windows: NDArray[np.int64] = data(
        "int64",
        "window",
        "window_field",
        unit="pixel",
        doc="rectangles in the patch: index of the sum to which the rectangle contributes, top, left, rows, columns and "
        "sign",
    )
    constant_counts: NDArray[np.int64] = data("int64", "feature", doc="number of constants of each feature")
    constants: NDArray[np.int32] = data("int32", "constant", doc="constants in the formulas of the features")

    @classmethod
    def of(cls, features: tuple[Feature, ...]) -> "StoredFeatures":
        """Convert one or more features to arrays."""
        windows = np.array([window for feature in features for window in feature.windows], np.int64)
        return cls(
            tuple(feature.name for feature in features),
            np.array([feature.size for feature in features]),
            np.array([len(feature.windows) for feature in features]),
            windows.reshape(-1, len(Window._fields)),
            np.array([len(feature.constants) for feature in features]),
            np.concatenate([feature.constants for feature in features]).astype(np.int32),
        )

    @cached_property
    def unpacked(self) -> tuple[Feature, ...]:
        """The features, converted back from arrays."""
        rows = [Window(*row) for row in self.windows.tolist()]
        window_end, constant_end = np.cumsum(self.window_counts), np.cumsum(self.constant_counts)
        return tuple(
            Feature(
                name,
                int(self.sizes[index]),
                tuple(rows[window_end[index] - self.window_counts[index] : window_end[index]]),
                self.constants[constant_end[index] - self.constant_counts[index] : constant_end[index]],
            )
            for index, name in enumerate(self.names)
        )

    def check(self, patch: int) -> None:
        """Raise ValueError unless the arrays describe valid features of `patch` × `patch` pixels."""
        if not self.names or len(set(self.names)) != len(self.names):
            raise ValueError("names must contain at least one feature, and every feature only once")
        if (self.sizes < 1).any() or math.prod(self.sizes.tolist()) > MAX_COMBINATIONS:
            raise ValueError(f"sizes must be positive, and their product must be at most {MAX_COMBINATIONS}")
        counts = ((self.window_counts, len(self.windows)), (self.constant_counts, len(self.constants)))
        if any((count < 0).any() or count.sum() != length for count, length in counts):
            raise ValueError("window_counts or constant_counts do not add up to the number of stored windows or constants")
        if self.windows.shape[1] != len(Window._fields):
            raise ValueError(f"windows has {self.windows.shape[1]} fields, but must have {len(Window._fields)}")
        number, top, left, rows, columns, sign = self.windows.T
        inside = (top >= 0) & (left >= 0) & (rows >= 1) & (columns >= 1) & (np.abs(sign) == 1)
        inside &= (top <= patch - rows) & (left <= patch - columns) & (number >= 0) & (number < len(number))
        if not inside.all():
            raise ValueError("windows must be within the patch, and their sign must be 1 or −1")
        if (rows * columns).sum() > MAX_WINDOW_TAPS:
            raise ValueError(f"windows contains {(rows * columns).sum()} taps, but at most {MAX_WINDOW_TAPS} are supported")


class ClassPlace(NamedTuple):
    """The feature values that identify a class: integers, or integer arrays of equal shape for several classes."""

    site: Any  # CFA row · (number of CFA columns) + CFA column
    level: Any
    contrast: Any
    combination: Any  # index that encodes the values of all additional features; 0 without additional features
    kind: Any  # index of the chroma if no channel is saturated, otherwise (number of chromas) − 1 + saturation case


@dataclass(frozen=True)
class ClassRule:
    """The integer rule that determines the class of a pixel from its patch (docs/method.md#classes).

    The index of a class is

        (((site · levels + level) · contrasts + contrast) · combinations + combination) · kinds + kind

    with site = row · (number of CFA columns) + column. If no pixel near the centre is saturated, the kind is the index of
    the chroma. Otherwise the kind is chromas − 1 + saturation case. The combination is an index that encodes the values of
    the additional features in the class recipe, such as the direction. Without additional features, it is 0.
    """

    patch: int = data("int64", unit="pixel", doc="side of the square patch around a pixel; always odd")
    shift: int = data("int64", unit="bit", doc="number of bits by which raw values are shifted right before they are summed")
    level_edges: NDArray[np.uint32] = data(
        "uint32",
        "level_edge",
        unit="DN >> shift, times 256 times channels",
        doc="sum of the channel means at which each level except the first begins",
    )
    contrast_edges: NDArray[np.uint32] = data(
        "uint32",
        "contrast_edge",
        "level",
        unit="(DN >> shift)^2, times 512",
        doc="sum of the channel variances above which each contrast except the first begins",
    )
    saturation: int = data("int64", unit="DN", doc="lowest value at which a pixel counts as saturated")
    saturation_radius: int = data(
        "int64", unit="pixel", doc="radius of the neighbourhood of a pixel that determines its saturation case"
    )
    case_of_code: NDArray[np.uint16] = data(
        "uint16",
        "code",
        doc="saturation case of each combination of saturated channels; bit c of the index: channel c is saturated",
    )
    chroma_black_level: int = data(
        "int64",
        unit="(DN >> shift) times 16",
        doc="black level that is subtracted from channel means to find the chroma",
    )
    chroma_weights: NDArray[np.int32] = data(
        "int32",
        "chroma",
        "channel",
        doc="weights of the channel means in the score of each chroma; a pixel has the chroma with the lowest score",
    )
    chroma_dither: int = data(
        "int64", default=0, doc="1: pixels between two chromas are assigned to either of them, alternating between sites"
    )
    features: StoredFeatures | None = group(default=None)  # None: the rule has no additional features
    spared_cases: int = data(
        "int64",
        default=0,
        doc="number of saturation cases, directly after case 0, in which every filter still has an unsaturated channel",
    )

    def __post_init__(self) -> None:
        check(self)
        if not 1 <= len(self.chroma_weights) <= MAX_CHROMAS or np.abs(self.chroma_weights).max() > 2 * CHROMA_SCALE:
            raise ValueError(
                f"chroma_weights must have 1 to {MAX_CHROMAS} rows, with values from −{2 * CHROMA_SCALE} to "
                f"{2 * CHROMA_SCALE}"
            )
        if self.patch % 2 == 0 or not 1 <= self.patch <= MAX_PATCH:
            raise ValueError(f"patch is {self.patch}, but must be an odd number from 1 to {MAX_PATCH}")
        if (np.diff(self.level_edges.astype(np.int64)) <= 0).any():
            raise ValueError("level_edges must increase, but there are more levels than distinct values; use fewer levels")
        if not 0 <= self.saturation_radius <= self.patch // 2 or self.saturation < 0:
            raise ValueError(
                f"saturation is {self.saturation} and saturation_radius is {self.saturation_radius}; saturation must not be "
                f"negative, and saturation_radius must be between 0 and the patch radius, {self.patch // 2}"
            )
        if self.contrast_edges.shape[1] != self.levels:
            raise ValueError(
                f"contrast_edges has {self.contrast_edges.shape[1]} levels, but level_edges defines {self.levels} levels"
            )
        if not 0 <= self.spared_cases < max(self.cases, 1):
            raise ValueError(
                f"spared_cases is {self.spared_cases}, but must be between 0 and {self.cases - 1}, the number of saturation "
                "cases in which a channel clips"
            )
        if self.features:
            self.features.check(self.patch)

    def check_fits(self, channels: int, bits: int) -> None:
        """Raise ValueError unless the rule fits a camera with `channels` channels and `bits`-bit raw values."""
        if not 0 <= self.shift <= bits <= self.shift + CLASS_BITS:
            raise ValueError(
                f"shift is {self.shift}, but must be between {max(bits - CLASS_BITS, 0)} and {bits}, because classes use "
                f"{CLASS_BITS} of the {bits} bits"
            )
        if self.channels != channels:
            raise ValueError(f"chroma_weights has {self.channels} channels, but the camera has {channels}")
        if len(self.case_of_code) != 2**channels:
            raise ValueError(f"case_of_code has {len(self.case_of_code)} values, but {channels} channels need {2**channels}")

    @property
    def radius(self) -> int:
        return self.patch // 2

    @property
    def channels(self) -> int:
        return self.chroma_weights.shape[1]

    @property
    def levels(self) -> int:
        return len(self.level_edges) + 1

    @property
    def contrasts(self) -> int:
        return len(self.contrast_edges) + 1

    @cached_property
    def cases(self) -> int:
        """Number of saturation cases, including case 0, in which no channel clips."""
        return int(self.case_of_code.max()) + 1

    @property
    def lost_cases(self) -> int:
        """Number of values that `lost` can return: 0, and one per saturation case with a completely clipped filter."""
        return self.cases - self.spared_cases

    @property
    def chromas(self) -> int:
        return len(self.chroma_weights)

    @property
    def kinds(self) -> int:
        """Number of chromas, plus the number of saturation cases in which a channel clips."""
        return self.chromas + self.cases - 1

    @property
    def feature_list(self) -> tuple[Feature, ...]:
        """The additional features, in order."""
        return self.features.unpacked if self.features else ()

    @cached_property
    def windows(self) -> tuple[Window, ...]:
        """The windows of all additional features, with sums that are numbered consecutively across features."""
        numbered: list[Window] = []
        first = 0
        for feature in self.feature_list:
            numbered += [window._replace(sum=first + window.sum) for window in feature.windows]
            first += feature.sums
        return tuple(numbered)

    @property
    def window_sums(self) -> int:
        """Number of window sums that all additional features need."""
        return sum(feature.sums for feature in self.feature_list)

    @property
    def combinations(self) -> int:
        """Number of possible combinations of additional feature values, or 1 without additional features."""
        return math.prod(feature.size for feature in self.feature_list)

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Numbers of levels, contrasts, combinations of additional features, and kinds (chromas and saturation cases)."""
        return self.levels, self.contrasts, self.combinations, self.kinds

    @property
    def classes_per_site(self) -> int:
        """Number of classes at each CFA site."""
        return math.prod(self.shape)

    def join(self, level: Any, contrast: Any, kind: Any, site: Any = 0, combination: Any = 0) -> Any:
        """Combine feature values into a class index. The values can be integers or integer arrays.

        Without `site`, the result is the class index within a site.
        """
        stem = (site * self.levels + level) * self.contrasts + contrast
        return (stem * self.combinations + combination) * self.kinds + kind

    def split(self, index: Any) -> ClassPlace:
        """Split class indices into feature values: the inverse of `join`."""
        rest, kind = divmod(index, self.kinds)
        rest, combination = divmod(rest, self.combinations)
        rest, contrast = divmod(rest, self.contrasts)
        site, level = divmod(rest, self.levels)
        return ClassPlace(site, level, contrast, combination, kind)

    def join_features(self, values: Any) -> Any:
        """Encode the values of the additional features, in order, as a single index."""
        combined: Any = 0
        for feature, value in zip(self.feature_list, values, strict=True):
            combined = combined * feature.size + value
        return combined

    def split_features(self, combined: Any) -> tuple[Any, ...]:
        """Decode the index of a combination to the values of the additional features: the inverse of `join_features`."""
        values = []
        for feature in reversed(self.feature_list):
            combined, value = divmod(combined, feature.size)
            values.append(value)
        return tuple(reversed(values))

    def on_site(self, index: Any, site: Any) -> Any:
        """Convert class indices within a site to class indices of the whole table."""
        return site * self.classes_per_site + index

    def within_site(self, index: Any) -> Any:
        """Convert class indices of the whole table to class indices within their site."""
        return index % self.classes_per_site

    def of_site(self, site: int) -> slice:
        """Return the range of a site's class indices."""
        return slice(site * self.classes_per_site, (site + 1) * self.classes_per_site)

    def by_feature(self, values: NDArray[Any]) -> NDArray[Any]:
        """Reshape an array from (class, …) to (site, level, contrast, combination, kind, …).

        The array can contain the classes of one site or of all sites.
        """
        return values.reshape(len(values) // self.classes_per_site, *self.shape, *values.shape[1:])

    def kind(self, chroma: Any, case: Any) -> Any:
        """Combine a chroma and a saturation case into one index, the kind. The chroma is ignored unless the case is 0."""
        return np.where(np.greater(case, 0), self.chromas - 1 + case, chroma)

    def case(self, kind: Any) -> Any:
        """Return the saturation case that each index `kind` stands for, or 0 if it stands for a chroma."""
        return np.maximum(kind, self.chromas - 1) - (self.chromas - 1)  # kinds may be unsigned: avoid negative differences

    def lost(self, kind: Any) -> Any:
        """Number the saturation cases in which all channels of a colour filter clip, from 1.

        The result is the number of the saturation case that `kind` stands for. It is 0 for chromas and for all other
        saturation cases.
        """
        return np.maximum(self.case(kind) - self.spared_cases, 0)

    def kinds_of(self, case: int) -> slice | int:
        """Return the values of `kind` for a saturation case: all chromas for case 0, otherwise a single value."""
        return self.chromas - 1 + case if case else slice(0, self.chromas)

    def join_cases(self, level: Any, contrast: Any, case: Any) -> Any:
        """Combine feature values into the index of a coarse class, which ignores chromas and additional features."""
        return (level * self.contrasts + contrast) * self.cases + case
