"""A table's second set of transforms: for pixels of which a filter in time has left little noise
(docs/method.md#noise-sets)."""

from dataclasses import dataclass, replace

from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.layers import MosaicLayer, PlaneLayer, PlaneRule, scaled_rule
from l3cli.artifacts.schema import check, data, equal, group


@dataclass(frozen=True)
class QuietSet:
    """Layers that are those of their table, but for transforms, edges that noise tells, and scales of gradients."""

    noise_left: float = data("float64", doc="share of the noise that varies in time, which is left where it was learned")
    first: MosaicLayer = group()
    later: tuple[PlaneLayer, ...] = group(default=())

    def __post_init__(self) -> None:
        check(self)
        if not 0 < self.noise_left < 1:
            raise ValueError(f"noise_left is {self.noise_left:g}, not between 0 and 1")

    @property
    def limit(self) -> float:
        """The share of the noise up to which a pixel is rendered by it: a quarter of the way, in logarithms, to all of the
        noise (docs/method.md#noise-sets)."""
        return self.noise_left**0.75

    def check_fits(self, first: MosaicLayer, later: tuple[PlaneLayer, ...]) -> None:
        """Raise ValueError if classes are not numbered as those of the table's own layers."""
        if not same_classes(self.first.rule, first.rule):
            raise ValueError("quiet/first has other classes than first")
        if self.first.weights.shape != first.weights.shape:
            raise ValueError("quiet/first has transforms of other shapes than first")
        if len(self.later) != len(later):
            raise ValueError(f"quiet holds {1 + len(self.later)} layers, the table {1 + len(later)}")
        for number, (layer, usual) in enumerate(zip(self.later, later, strict=True)):
            if not same_plane_classes(layer.rule, usual.rule):
                raise ValueError(f"quiet/later/{number} has other classes than later/{number}")
            if (layer.side, layer.weights.shape) != (usual.side, usual.weights.shape):
                raise ValueError(f"quiet/later/{number} has windows or transforms of other shapes than later/{number}")


def same_classes(rule: ClassRule, usual: ClassRule) -> bool:
    """Return whether a rule of first layers is the usual one but for edges that follow the noise."""
    features = rule.features and usual.features and replace(rule.features, constants=usual.features.constants)
    return equal(replace(rule, contrast_edges=usual.contrast_edges, features=features), usual)


def same_plane_classes(rule: PlaneRule, usual: PlaneRule) -> bool:
    """Return whether a rule of later layers is the usual one but for the scale of gradients."""
    return type(rule) is type(usual) and equal(scaled_rule(usual, rule), rule)
