"""Class and learning recipes (configs/classes)."""

import itertools
from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, ClassVar, Literal

import msgspec
import numpy as np

from l3cli.artifacts.camera import CameraModel, NoiseScale
from l3cli.artifacts.class_rule import MAX_PATCH
from l3cli.artifacts.layers import RATIO_TAPS
from l3cli.artifacts.plane_rules import MAX_LEAVES
from l3cli.artifacts.recipe_source import RecipeSource
from l3cli.artifacts.table import WINDOWS
from l3cli.classes import contrast, level
from l3cli.classes.features import ClassRecipe
from l3cli.errors import RecipeError
from l3cli.recipes.faults import Fault, fault
from l3cli.recipes.toml import Count, CountOrNone, NotNegative, Positive, Recipe, Share
from l3cli.training.symmetry import EVERY_ORIENTATION, IDENTITY_ONLY, Allowed

MOST_PATCHES = 1_000_000_000
MOST_REFINEMENT = 3  # largest number of layers after the first
MOST_STRENGTH = 1e5  # largest edge of the trace of the structure tensor, far above what gradients reach
MOST_OF_HIGHLIGHTS = 0.5  # largest `darkest` level as a fraction of `highlight_from`, for very noisy cameras
LEAST_SENSITIVE = 1 / 16  # smallest relative sensitivity of a channel that planes can represent (docs/method.md#exposures)
LEAST_BETWEEN = 1 / 4  # the same if an intermediate layer reads 16-bit planes (docs/method.md#planes)
LEAST_STEP = 0.001  # smallest difference between such edges, which are stored as integers
ErrorPower = Annotated[float, msgspec.Meta(ge=0, le=0.5)]
MOST_DRAWS = 1000  # largest number of levels per patch; more would add no information


class LearningRecipe(Recipe):
    """Recipe by which the transforms of the classes are learned (docs/method.md#training). Levels are shares of full
    scale."""

    patches: Annotated[int, msgspec.Meta(ge=1, le=MOST_PATCHES)] = 60000  # patches a canonical CFA position, over all frames
    draws: Annotated[int, msgspec.Meta(ge=1, le=MOST_DRAWS)] = 8  # levels drawn a patch (docs/method.md#level-rescaling)
    # levels drawn a patch in the pass whose errors weigh the samples of the second; 0: one pass only
    first_draws: Annotated[int, msgspec.Meta(ge=0, le=MOST_DRAWS)] = 3
    darkest: float = 0.0  # levels are drawn log-uniformly from here; 0: from where the camera's noise equals the signal
    dark_share: Share = 0.0  # share of the draws that lies below `darkest`, down to half of it, for frames of higher gain
    brightest: float = 2.5  # levels are drawn up to here, clipped at the white level
    highlight_share: Share = 0.25  # share of the draws that lies above `highlight_from`
    highlight_from: float = 0.15  # begin of the highlights, which end at `brightest`
    achromatic: Share = 0.0  # share of the patches that show their scene without colour (docs/method.md#patches)
    rescale: bool = True  # False: patches stay at the level of their frame, however often they are drawn
    # noise-free patches and a covariance, patches with noise drawn, or no noise at all, neither in classes nor in patches;
    # without a covariance the weights below weigh nothing, and without noise those of a layer only rounding to DN
    noise: Literal["analytic", "sampled", "none"] = "analytic"
    # share of the noise over time for which a second set of transforms is learned, for pixels of which --temporal has left
    # little noise (docs/method.md#noise-sets); 0: none
    noise_left: Annotated[float, msgspec.Meta(ge=0, lt=1)] = 0.0
    # lights of the training for each of which transforms are learned besides those of all, as its frames name them; the
    # white of a scene chooses (docs/method.md#several-lights)
    lights: tuple[str, ...] = ()
    level_power: Share = 1.0  # samples weigh level^-power: 1 for errors relative to the level, 0 for errors as they are
    brightness_power: Share = 0.5  # samples weigh (Y / level)^-power (docs/method.md#sample-weights)
    error_power: ErrorPower = 0.25  # second pass: (e² + ¼)^-power, e the error of the first (docs/method.md#second-pass)
    ridge: Positive = 1e-5  # relative to the mean power of a tap
    luminance_noise: NotNegative = 1.5  # weight of the noise covariance for Y (docs/method.md#noise-weights)
    chroma_noise: NotNegative = 2.0  # the same for the two chroma planes
    level_pool: tuple[float, ...] = (0.5, 0.25)  # weight of classes one, two… levels away (docs/method.md#thin-classes)
    # pseudo-patches of the parent, all chromas of its level, contrast and case, added to every class
    parent_patches: CountOrNone = 200
    # uniform areas of measured surfaces, a patch of a plain class (docs/method.md#plain-surfaces)
    plain_surfaces: NotNegative = 0.3
    # where the outputs are a spectrum, the side in pixels, odd, of the neighbourhood whose mean spectrum a pixel
    # takes, keeping its brightness (docs/method.md#smoothed-spectra); 0: its spectrum is its own
    spectral_window: Annotated[int, msgspec.Meta(ge=0, le=WINDOWS[-1])] = 0
    # difference of brightness, a share of the pixel's own, from which a neighbour does not count
    spectral_reach: Annotated[float, msgspec.Meta(gt=0, lt=1)] = 0.3
    symmetry: bool = True  # rotated or mirrored CFA sites share their training (docs/method.md#symmetry)
    equal_response: bool = True  # all CFA sites answer a flat patch alike (docs/method.md#equal-response)

    @property
    def orientations(self) -> Allowed:
        """Orientations in which CFA sites may be trained as each other. All eight assume isotropic noise (`symmetry`)."""
        return EVERY_ORIENTATION if self.symmetry else IDENTITY_ONLY

    @property
    def noises(self) -> tuple[NoiseScale, ...]:
        """Return the noises, over the camera's, that further transforms are learned for."""
        return (NoiseScale(noise_left=self.noise_left),) if self.noise_left else ()


class LayerRecipe(Recipe):
    """Recipe of a layer that reads the planes of the layer before (docs/method.md#layers)."""

    side: Annotated[int, msgspec.Meta(ge=1, le=9)] = 5  # pixels, odd, of the windows of each plane
    # classes, of a tree grown for them; 0: by structure, as next
    leaves: Annotated[int, msgspec.Meta(ge=0, le=MAX_LEAVES)] = 0
    # pixels of a canonical CFA position it is grown on
    tree_rows: Annotated[int, msgspec.Meta(ge=1000, le=1_000_000)] = 40000
    level_step: Count = 1  # levels of the first layer that make one
    strengths: tuple[Positive, ...] = (1.7, 8.0)  # edges of the structure tensor's trace, relative to that of noise
    coherence: Share = 0.48  # share of the trace along one direction from which an edge has one
    mosaics: Annotated[int, msgspec.Meta(ge=1, le=MOST_PATCHES)] = 5400  # over all frames
    achromatic: Share = 0.2  # share of them that show their scene without colour
    # pixels of a mosaic, a square of at least so many, that are learned from
    rows: Annotated[int, msgspec.Meta(ge=1, le=MOST_PATCHES)] = 900
    # share of the square's pixels that they are: less than 1 where mosaics are to be large, as samples count by their error
    density: Annotated[float, msgspec.Meta(gt=0, le=1)] = 1.0
    ridge: Positive = 1e-5  # relative to the mean power of a tap
    luminance_noise: NotNegative = 1.5  # weight of the noise covariance for Y
    chroma_noise: NotNegative = 2.0  # the same for the two chroma planes
    # samples weigh (Y / level)^-power and (e² + ¼)^-power, e the error of the layers before; as in [learning] if not given
    brightness_power: Share | None = None
    error_power: ErrorPower | None = None
    # further taps of the last layer: chroma as shading would make it (docs/method.md#colour-ratios)
    colour_ratios: bool = False
    bilateral_chroma: bool = False  # and that of pixels alike (docs/method.md#colour-ratios)
    # chroma of the last layer comes from far around, where pixels are alike, and no class fades that of plain
    # windows (docs/method.md#coarse-chroma)
    coarse_chroma: bool = False
    level_pool: tuple[NotNegative, ...] = (0.5, 0.25)  # weight of classes one, two… levels away
    strength_pool: NotNegative = 0.0  # the same of classes of the same direction one strength away, beyond the lowest
    parent_patches: CountOrNone = 200  # pseudo-samples of the parent, added to every class

    @property
    def ratio_taps(self) -> int:
        """Return the number of taps behind the windows."""
        return RATIO_TAPS[self.colour_ratios + self.bilateral_chroma]


class TrainingRecipe(Recipe):
    """Classes and learning of the first layer, and layers after it. Keys that a recipe leaves out are those of one layer;
    without any recipe configs/classes/default.toml is taken."""

    title: ClassVar[str] = "a class recipe"

    classes: ClassRecipe = msgspec.field(default_factory=ClassRecipe)
    learning: LearningRecipe = msgspec.field(default_factory=LearningRecipe)
    layer: Annotated[tuple[LayerRecipe, ...], msgspec.Meta(max_length=MOST_REFINEMENT)] = ()  # layers after the first


def for_camera(recipe: TrainingRecipe, camera: CameraModel) -> TrainingRecipe:
    """Fill in the values that a recipe leaves to the camera.

    If the recipe has no darkest level, it is the level at which the signal equals the noise, but not below the levels of the
    classes (docs/method.md#level-rescaling). If the channels differ in exposure, the brightest level is raised so that the
    least sensitive channel clips, too (docs/method.md#exposures).

    Parameters
    ----------
    recipe : TrainingRecipe
    camera : CameraModel

    Returns
    -------
    TrainingRecipe

    Raises
    ------
    RecipeError
        If the sensitivities of the channels differ more than the planes between layers can represent.
    """
    learning, sensitivity = recipe.learning, camera.sensitivity
    mean = float(sensitivity.mean())
    for further, least, layers in (
        (0, LEAST_SENSITIVE, "one layer, such as single"),
        (1, LEAST_BETWEEN, "two layers, such as default"),
    ):
        if len(recipe.layer) > further and sensitivity.min() < least:
            raise RecipeError(
                f"channels of {camera.name} differ {1 / sensitivity.min():.3g} times in exposure and gain, of which tables "
                f"of so many layers hold {1 / least:g}; take a class recipe of {layers}"
            )
    if camera.readout is not None:
        learning = msgspec.structs.replace(learning, brightest=learning.brightest * mean / float(sensitivity.min()))
    if learning.darkest:
        return msgspec.structs.replace(recipe, learning=learning)
    constant, linear, quadratic = camera.noise_terms(channel=np.arange(len(camera.channels)))
    power = max(1 - quadratic, 1e-6)  # of s² = constant + linear s + quadratic s²
    signals = (linear + np.sqrt(linear**2 + 4 * power * constant)) / (2 * power)
    signal = float(np.min(signals / sensitivity)) * mean
    level = max(signal / (camera.white_level - camera.black_level), recipe.classes.lowest_level * mean)
    darkest = min(level, MOST_OF_HIGHLIGHTS * learning.highlight_from)
    return msgspec.structs.replace(recipe, learning=msgspec.structs.replace(learning, darkest=darkest))


def for_noise(recipe: TrainingRecipe, camera: CameraModel) -> TrainingRecipe:
    """Return `for_camera` of the recipe for the camera without temporal filtering, which does not change the recipe."""
    return for_camera(recipe, replace(camera, noise_left=1.0))


def draft_of(recipe: TrainingRecipe) -> TrainingRecipe:
    """Return the recipe of a draft.

    A draft uses three tenths of the patches and a third of the levels. It has no further lights or noises and a single
    layer, which suppresses noise as much as the last layer of the recipe.
    """
    learning = recipe.learning
    last = recipe.layer[-1] if recipe.layer else learning
    learning = msgspec.structs.replace(
        learning, patches=-(-learning.patches * 3 // 10), draws=-(-learning.draws // 3),
        first_draws=-(-learning.first_draws // 3), luminance_noise=last.luminance_noise, chroma_noise=last.chroma_noise,
        noise_left=0.0, lights=(),
    )  # fmt: skip
    return msgspec.structs.replace(recipe, learning=learning, layer=())


def require_one_go(learning: LearningRecipe) -> None:
    """Raise a RecipeError if a sharded run is to learn transforms for single lights."""
    if learning.lights:
        raise RecipeError(
            "learning.lights: transforms for each light are learned in one go, not in shards; train without ‹shard›, on "
            "several machines with ‹scheduler›"
        )


def learning_faults(recipe: LearningRecipe) -> Iterator[Fault]:
    """Yield the faults of the [learning] section."""
    if not 0 <= recipe.darkest < recipe.highlight_from < recipe.brightest:
        keys = ("learning.darkest", "learning.highlight_from", "learning.brightest")
        yield fault("learning needs 0 ≤ darkest < highlight_from < brightest", *keys)
    if (ends := recipe.dark_share + recipe.highlight_share) > 1:
        message = f"learning.dark_share and learning.highlight_share are {ends:g} together, more than all draws"
        yield fault(message, "learning.dark_share", "learning.highlight_share")
    if recipe.noise_left and recipe.noise == "none":
        yield fault('learning.noise_left has no noise to leave a share of where noise is "none"', "learning.noise_left")
    if recipe.lights and len(set(recipe.lights)) < max(2, len(recipe.lights)):
        yield fault("learning.lights must name several lights, each once", "learning.lights")
    if recipe.spectral_window not in (0, *WINDOWS):
        message = f"learning.spectral_window is {recipe.spectral_window}, not 0 or one of {', '.join(map(str, WINDOWS))}"
        yield fault(message, "learning.spectral_window")


def layer_faults(layers: tuple[LayerRecipe, ...]) -> Iterator[Fault]:
    """Yield the faults of the [[layer]] sections."""
    for number, recipe in enumerate(layers):
        name, key = f"layer[{number + 1}]", f"layer.{number}"
        if recipe.colour_ratios and number + 1 < len(layers):
            yield fault(f"{name}.colour_ratios is for the last layer alone", f"{key}.colour_ratios")
        if recipe.bilateral_chroma and not recipe.colour_ratios:
            yield fault(f"{name}.bilateral_chroma is for a layer with colour_ratios", f"{key}.bilateral_chroma")
        if recipe.coarse_chroma and number + 1 < len(layers):
            yield fault(f"{name}.coarse_chroma is for the last layer alone", f"{key}.coarse_chroma")
        if recipe.side % 2 == 0:
            yield fault(f"{name}.side is {recipe.side}; windows have odd sides", f"{key}.side")
        if not recipe.strengths or any(high - low < LEAST_STEP for low, high in itertools.pairwise(recipe.strengths)):
            message = f"{name}.strengths must be one or more numbers, each {LEAST_STEP:g} above the last"
            yield fault(message, f"{key}.strengths")
        elif recipe.strengths[-1] > MOST_STRENGTH:
            yield fault(f"{name}.strengths exceed {MOST_STRENGTH:g}", f"{key}.strengths")


def class_recipe_faults(recipe: TrainingRecipe, source: RecipeSource) -> Iterator[Fault]:
    """Yield all faults of a class recipe, including those for its camera if one is given."""
    yield from learning_faults(recipe.learning)
    yield from layer_faults(recipe.layer)
    classes = recipe.classes
    if classes.patch % 2 == 0 or not 1 <= classes.patch <= MAX_PATCH:
        yield fault(f"classes.patch is {classes.patch}, not an odd number up to {MAX_PATCH}", "classes.patch")
    yield from source.attempt(None, contrast.check_edges, classes)
    yield from source.attempt(None, level.edge_shares, classes)
