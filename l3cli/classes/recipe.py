"""Class recipes: the keys of all features, which are declared in their modules."""

from typing import TYPE_CHECKING, Any

import msgspec

from l3cli.artifacts.camera import CameraModel
from l3cli.classes import chroma, contrast, level, saturation
from l3cli.classes.features import FURTHER
from l3cli.recipes.toml import Count, Recipe

if TYPE_CHECKING:

    class ClassRecipe(level.Options, contrast.Options, saturation.Options, chroma.Options):
        """Recipe of the classes that pixels are sorted into (configs/classes)."""

        patch: Count = 9  # pixels, side of the neighbourhood

else:

    def _fields(keys: type[Recipe]) -> list[tuple[str, Any, Any]]:
        """Name, type and default of the keys of a feature that every rule has."""
        return [(field.name, field.type, field.default) for field in msgspec.structs.fields(keys)]

    # patch: pixels, side of the neighbourhood. Further features have a table each, which switches them on.
    ClassRecipe = msgspec.defstruct(
        "ClassRecipe",
        [
            ("patch", Count, 9),
            *(field for feature in (level, contrast, saturation, chroma) for field in _fields(feature.Options)),
            *((name, feature.Options | None, None) for name, feature in FURTHER.items()),
        ],
        bases=(Recipe,),
        module=__name__,
    )


def switched_on(recipe: ClassRecipe) -> dict[str, Any]:
    """Return the tables of the further features that a recipe has, by name, in the order of FURTHER."""
    return {name: keys for name in FURTHER if (keys := getattr(recipe, name)) is not None}


def left_out(recipe: ClassRecipe, camera: CameraModel) -> list[str]:
    """Return the names of the features switched on that patches are too small for on a camera's array."""
    return [name for name in switched_on(recipe) if not FURTHER[name].fits(camera, recipe.patch)]
