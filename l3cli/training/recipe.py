"""Class recipes: the keys for the first layer and the refinement layers, and checks of their values."""

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
from l3cli.training.symmetry import IDENTITY_ONLY, Allowed, orientations_of_frames

MOST_PATCHES = 1_000_000_000
MOST_REFINEMENT = 3  # largest number of refinement layers
MOST_STRENGTH = 1e5  # largest value in `strengths`, far above the trace of any structure tensor
MOST_OF_HIGHLIGHTS = 0.5  # largest automatic `darkest`, as a fraction of `highlight_from`; reached only with very high noise
LEAST_SENSITIVE = 1 / 16  # smallest relative sensitivity of a channel with one refinement layer (docs/method.md#exposures)
# Smallest relative sensitivity of a channel with several refinement layers. The layers exchange 16-bit planes, which limits
# the range of sensitivities.
LEAST_BETWEEN = 1 / 4
LEAST_STEP = 0.001  # smallest difference between two values in `strengths`, which are stored as integers
ErrorPower = Annotated[float, msgspec.Meta(ge=0, le=0.5)]
MOST_DRAWS = 1000  # largest number of levels per patch; more levels would add no information


class LearningRecipe(Recipe):
    """How the transforms of the first layer are trained (docs/method.md#training). Levels are fractions of full scale."""

    # number of training patches per CFA site, over all frames; symmetric sites share their patches
    patches: Annotated[int, msgspec.Meta(ge=1, le=MOST_PATCHES)] = 60000
    # number of random levels per patch (docs/method.md#level-rescaling)
    draws: Annotated[int, msgspec.Meta(ge=1, le=MOST_DRAWS)] = 8
    # number of random levels per patch in the first of two training passes; with 0, there is only one pass
    first_draws: Annotated[int, msgspec.Meta(ge=0, le=MOST_DRAWS)] = 3
    # lower limit of the random levels, whose distribution is log-uniform; a fraction of the levels, `dark_share`, may be
    # lower; with 0, the limit is the level at which the signal equals its noise
    darkest: float = 0.0
    # fraction of the random levels that are drawn between half of `darkest` and `darkest`, for frames taken at a higher gain
    dark_share: Share = 0.0
    brightest: float = 2.5  # highest random level; scaled patches are clipped at the white level
    highlight_share: Share = 0.25  # fraction of the random levels that are drawn between `highlight_from` and `brightest`
    highlight_from: float = 0.15  # lower end of the range for `highlight_share`
    achromatic: Share = 0.0  # fraction of the patches in which greys replace all colours (docs/method.md#patches)
    rescale: bool = True  # whether patches are scaled to random levels; if false, they keep the level of their frame
    # "analytic" adds the computed noise covariance to the equations; "sampled" adds random noise to the patches, so that
    # luminance_noise and chroma_noise have no effect; "none" trains for noise-free frames
    noise: Literal["analytic", "sampled", "none"] = "analytic"
    # fraction of the temporal noise for which a second set of transforms is trained, or 0 for no second set;
    # l3 render --temporal uses this set for pixels whose noise is low after the temporal filter (docs/method.md#noise-sets)
    noise_left: Annotated[float, msgspec.Meta(ge=0, lt=1)] = 0.0
    # illuminants for which separate transforms are trained in addition to the common ones; at rendering, the white of the
    # scene selects the transforms (docs/method.md#several-illuminants)
    lights: tuple[str, ...] = ()
    # training samples have the weight level^-power: 1 minimises errors relative to the level, 0 minimises absolute errors
    level_power: Share = 1.0
    brightness_power: Share = 0.5  # training samples have the weight (Y / level)^-power (docs/method.md#sample-weights)
    # samples of the second pass have the weight (e² + ¼)^-power, where e is the error of the first pass
    # (docs/method.md#second-pass)
    error_power: ErrorPower = 0.25
    ridge: Positive = 1e-5  # ridge (Tikhonov) regularisation, relative to the mean power of a tap
    # weight of the noise covariance for Y; outputs other than X, Y and Z use the same weight, but at most 1
    # (docs/method.md#noise-weights)
    luminance_noise: NotNegative = 1.5
    chroma_noise: NotNegative = 2.0  # weight of the noise covariance for the two chroma outputs
    # weights of samples from classes one level away, two levels away and so on (docs/method.md#classes-with-few-patches)
    level_pool: tuple[float, ...] = (0.5, 0.25)
    # number of pseudo-patches that every class receives from its parent, the mean over all chromas with the same level,
    # contrast and saturation case
    parent_patches: CountOrNone = 200
    # in classes for uniform areas: weight of uniform patches with measured reflectances, relative to the other patches
    # (docs/method.md#uniform-surfaces)
    plain_surfaces: NotNegative = 0.3
    # spectral outputs only: width in pixels (odd) of the window for smoothing spectra, or 0 for no smoothing; smoothing
    # preserves the brightness of each pixel (docs/method.md#smoothed-spectra)
    spectral_window: Annotated[int, msgspec.Meta(ge=0, le=WINDOWS[-1])] = 0
    # smoothing ignores pixels that differ by at least this fraction in brightness from the central pixel
    spectral_reach: Annotated[float, msgspec.Meta(gt=0, lt=1)] = 0.3
    # X, Y, Z only: smoothing averages the chroma of neighbours if their X/Y and Z/Y, relative to white, differ by less than
    # this limit; 0 for no smoothing (docs/method.md#smoothed-chroma)
    chroma_likeness: NotNegative = 0.0
    # smoothing averages the chroma of neighbours only if their luminances differ by less than this fraction
    chroma_reach: Annotated[float, msgspec.Meta(gt=0, lt=1)] = 0.6
    symmetry: bool = True  # whether rotated and mirrored CFA sites are trained together (docs/method.md#symmetry)
    # whether all CFA sites must produce the same outputs for a uniform patch (docs/method.md#equal-response)
    equal_response: bool = True

    def orientations(self, camera: CameraModel) -> Allowed:
        """Return the orientations in which CFA sites may be trained together: only the identity if `symmetry` is false."""
        return orientations_of_frames(camera) if self.symmetry else IDENTITY_ONLY

    @property
    def noises(self) -> tuple[NoiseScale, ...]:
        """Noise levels, relative to the camera model, for which additional transforms are trained."""
        return (NoiseScale(noise_left=self.noise_left),) if self.noise_left else ()


class LayerRecipe(Recipe):
    """Settings of a refinement layer, which filters the output planes of the previous layer (docs/method.md#layers)."""

    side: Annotated[int, msgspec.Meta(ge=1, le=9)] = 5  # width of the window in each plane, in pixels (odd)
    # largest number of leaves if a decision tree assigns pixels to classes; with 0, a structure tensor assigns them
    leaves: Annotated[int, msgspec.Meta(ge=0, le=MAX_LEAVES)] = 0
    # number of pixels per CFA site on which the tree is trained
    tree_rows: Annotated[int, msgspec.Meta(ge=1000, le=1_000_000)] = 40000
    level_step: Count = 1  # number of first-layer levels merged into one level of this layer
    # boundaries between structure strengths: trace of the structure tensor, relative to its trace from noise alone
    strengths: tuple[Positive, ...] = (1.7, 8.0)
    # an edge gets a direction class if the structure tensor's component in this direction exceeds this fraction of its trace
    coherence: Share = 0.48
    # number of training mosaics over all frames
    mosaics: Annotated[int, msgspec.Meta(ge=1, le=MOST_PATCHES)] = 5400
    achromatic: Share = 0.2  # fraction of the mosaics in which greys replace all colours
    rows: Annotated[int, msgspec.Meta(ge=1, le=MOST_PATCHES)] = 900  # approximate number of training samples per mosaic
    # fraction of a mosaic's pixels that become samples; with a smaller fraction, mosaics are larger for the same `rows`
    density: Annotated[float, msgspec.Meta(gt=0, le=1)] = 1.0
    ridge: Positive = 1e-5  # ridge (Tikhonov) regularisation, relative to the mean power of a tap
    luminance_noise: NotNegative = 1.5  # weight of the noise covariance for Y, or for spectral outputs
    chroma_noise: NotNegative = 2.0  # weight of the noise covariance for the two chroma planes
    # training samples have the weight (Y / level)^-power; if omitted, the power in [learning] applies
    brightness_power: Share | None = None
    # training samples have the weight (e² + ¼)^-power, where e is the error of the previous layers; if omitted, the power
    # in [learning] applies
    error_power: ErrorPower | None = None
    # last layer only: whether the transforms also use the chroma that a pixel would have if only the shading varied
    # (docs/method.md#colour-ratios)
    colour_ratios: bool = False
    # with colour_ratios only: whether the transforms also use the mean chroma of similar pixels
    # (docs/method.md#colour-ratios)
    bilateral_chroma: bool = False
    # last layer only: whether chroma is averaged over a wide area of similar pixels (docs/method.md#coarse-chroma)
    coarse_chroma: bool = False
    level_pool: tuple[NotNegative, ...] = (0.5, 0.25)  # weights of samples one level away, two levels away and so on
    # weight of samples with the same direction and an adjacent strength; the lowest strength is excluded
    strength_pool: NotNegative = 0.0
    # number of pseudo-samples that every class receives from its parent, the mean over all structures of a level
    parent_patches: CountOrNone = 200

    @property
    def ratio_taps(self) -> int:
        """Number of additional taps for colour ratios and bilateral chroma, which follow the window taps."""
        return RATIO_TAPS[self.colour_ratios + self.bilateral_chroma]


class TrainingRecipe(Recipe):
    """A class recipe: the classes of the first layer, their training, and up to three refinement layers.

    The defaults describe a table without refinement layers.
    """

    title: ClassVar[str] = "a class recipe"

    classes: ClassRecipe = msgspec.field(default_factory=ClassRecipe)
    learning: LearningRecipe = msgspec.field(default_factory=LearningRecipe)
    layer: Annotated[tuple[LayerRecipe, ...], msgspec.Meta(max_length=MOST_REFINEMENT)] = ()  # refinement layers


def for_camera(recipe: TrainingRecipe, camera: CameraModel) -> TrainingRecipe:
    """Adapt the range of training levels in a class recipe to a camera.

    If `darkest` is 0, it becomes the level at which the signal equals its noise, or the lowest level of the classes if that
    is higher (docs/method.md#level-rescaling). If the channels differ in exposure or gain, `brightest` is raised until the
    least sensitive channel also clips (docs/method.md#exposures).

    Parameters
    ----------
    recipe : TrainingRecipe
        Class recipe.
    camera : CameraModel
        Camera for which the table is trained.

    Raises
    ------
    RecipeError
        If the sensitivities of the channels differ by a larger factor than the recipe's number of layers allows
        (LEAST_SENSITIVE, LEAST_BETWEEN).
    """
    learning, sensitivity = recipe.learning, camera.sensitivity
    mean = float(sensitivity.mean())
    for further, least, layers in (
        (0, LEAST_SENSITIVE, 'one layer, such as "single"'),
        (1, LEAST_BETWEEN, 'two layers, such as "default"'),
    ):
        if len(recipe.layer) > further and sensitivity.min() < least:
            raise RecipeError(
                f"the channels of {camera.name} differ by a factor of {1 / sensitivity.min():.3g} in exposure and gain, but "
                f"a table with {1 + len(recipe.layer)} layers allows at most {1 / least:g}; use a class recipe with {layers}"
            )
    if camera.readout is not None:
        learning = msgspec.structs.replace(learning, brightest=learning.brightest * mean / float(sensitivity.min()))
    if learning.darkest:
        return msgspec.structs.replace(recipe, learning=learning)
    constant, linear, quadratic = camera.noise_terms(channel=np.arange(len(camera.channels)))
    power = max(1 - quadratic, 1e-6)  # solve s² = constant + linear s + quadratic s² for the signal s
    signals = (linear + np.sqrt(linear**2 + 4 * power * constant)) / (2 * power)
    signal = float(np.min(signals / sensitivity)) * mean
    level = max(signal / (camera.white_level - camera.black_level), recipe.classes.lowest_level * mean)
    darkest = min(level, MOST_OF_HIGHLIGHTS * learning.highlight_from)
    return msgspec.structs.replace(recipe, learning=msgspec.structs.replace(learning, darkest=darkest))


def for_noise(recipe: TrainingRecipe, camera: CameraModel) -> TrainingRecipe:
    """Adapt a class recipe to a camera like `for_camera`, but for frames without temporal noise reduction."""
    return for_camera(recipe, replace(camera, noise_left=1.0))


def draft_of(recipe: TrainingRecipe) -> TrainingRecipe:
    """Simplify a class recipe for ``l3 train --draft``.

    A draft uses three tenths of the patches and a third of the random levels. Its table has a single layer with the noise
    weights of the recipe's last layer, and no transforms for single illuminants or other noise levels.
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
    """Raise RecipeError if the recipe contains transforms for single illuminants, which cannot be trained in shards."""
    if learning.lights:
        raise RecipeError(
            "transforms for single illuminants (learning.lights) cannot be trained in shards; train without ‹shard›, or "
            "use ‹scheduler› to train on several machines"
        )


def learning_faults(recipe: LearningRecipe) -> Iterator[Fault]:
    """Yield the faults in the [learning] section."""
    if not 0 <= recipe.darkest < recipe.highlight_from < recipe.brightest:
        keys = ("learning.darkest", "learning.highlight_from", "learning.brightest")
        message = (
            f"learning.darkest, highlight_from and brightest are {recipe.darkest:g}, {recipe.highlight_from:g} and "
            f"{recipe.brightest:g}; choose values with 0 ≤ darkest < highlight_from < brightest"
        )
        yield fault(message, *keys)
    if (ends := recipe.dark_share + recipe.highlight_share) > 1:
        message = f"the sum of learning.dark_share and learning.highlight_share is {ends:g}; reduce the sum to at most 1"
        yield fault(message, "learning.dark_share", "learning.highlight_share")
    if recipe.noise_left and recipe.noise == "none":
        message = f'learning.noise_left is {recipe.noise_left:g}, but learning.noise is "none"; remove one of the two keys'
        yield fault(message, "learning.noise_left")
    if recipe.lights and len(set(recipe.lights)) < max(2, len(recipe.lights)):
        yield fault("learning.lights must list at least two illuminants, and each illuminant only once", "learning.lights")
    if recipe.spectral_window not in (0, *WINDOWS):
        message = (
            f"learning.spectral_window is {recipe.spectral_window}; use 0 for no smoothing, or one of "
            f"{', '.join(map(str, WINDOWS))}"
        )
        yield fault(message, "learning.spectral_window")


def layer_faults(layers: tuple[LayerRecipe, ...]) -> Iterator[Fault]:
    """Yield the faults in the [[layer]] sections."""
    for number, recipe in enumerate(layers):
        name, key = f"layer[{number + 1}]", f"layer.{number}"
        if recipe.colour_ratios and number + 1 < len(layers):
            yield fault(f"{name}.colour_ratios is allowed only in the last layer; remove the key", f"{key}.colour_ratios")
        if recipe.bilateral_chroma and not recipe.colour_ratios:
            message = f"{name}.bilateral_chroma needs colour_ratios; add colour_ratios = true to this layer"
            yield fault(message, f"{key}.bilateral_chroma")
        if recipe.coarse_chroma and number + 1 < len(layers):
            yield fault(f"{name}.coarse_chroma is allowed only in the last layer; remove the key", f"{key}.coarse_chroma")
        if recipe.side % 2 == 0:
            yield fault(f"{name}.side is {recipe.side}; use an odd number", f"{key}.side")
        if not recipe.strengths or any(high - low < LEAST_STEP for low, high in itertools.pairwise(recipe.strengths)):
            message = f"{name}.strengths must be one or more increasing numbers, at least {LEAST_STEP:g} apart"
            yield fault(message, f"{key}.strengths")
        elif recipe.strengths[-1] > MOST_STRENGTH:
            message = f"{name}.strengths contains {recipe.strengths[-1]:g}; use values of at most {MOST_STRENGTH:g}"
            yield fault(message, f"{key}.strengths")


def class_recipe_faults(recipe: TrainingRecipe, source: RecipeSource) -> Iterator[Fault]:
    """Yield all faults in a class recipe."""
    yield from learning_faults(recipe.learning)
    yield from layer_faults(recipe.layer)
    classes = recipe.classes
    if classes.patch % 2 == 0 or not 1 <= classes.patch <= MAX_PATCH:
        yield fault(f"classes.patch is {classes.patch}; use an odd number up to {MAX_PATCH}", "classes.patch")
    yield from source.attempt(None, contrast.check_edges, classes)
    yield from source.attempt(None, level.edge_shares, classes)
