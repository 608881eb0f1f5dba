"""Goal of a table's low-noise transforms: a camera from which a filter in time has taken noise
(docs/method.md#noise-sets)."""

from dataclasses import dataclass, fields, replace
from typing import Any

from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule
from l3cli.classes.recipe import ClassRecipe
from l3cli.classes.rule import make_rule


@dataclass(frozen=True)
class FilteredCamera(CameraModel):
    """A camera with a share of its noise over time, all of what its pixels differ by, and all rounding."""

    noise_left: float = 1.0

    @classmethod
    def of(cls, camera: CameraModel, noise_left: float) -> "FilteredCamera":
        """A camera of which the share `noise_left` of the variance over time is left."""
        held: dict[str, Any] = {field.name: getattr(camera, field.name) for field in fields(CameraModel)}
        return cls(**held, noise_left=noise_left)

    def noise_terms(self, dark: float = 0.0, channel: NDArray | None = None, left: float = 1.0) -> tuple[Any, Any, float]:
        """As CameraModel."""
        return super().noise_terms(dark, channel, left * self.noise_left)


def quiet_rule(usual: ClassRule, recipe: ClassRecipe, camera: FilteredCamera, dark: float) -> ClassRule:
    """The class rule of the quiet set: the usual one with edges by the noise that is left, in frames of which `dark` DN of
    dark current have been taken off."""
    made = make_rule(recipe, camera, usual.case_of_code, dark=dark)
    return replace(usual, contrast_edges=made.contrast_edges, features=made.features)
