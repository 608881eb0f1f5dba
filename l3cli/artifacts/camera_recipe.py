"""Camera recipes: TOML files that describe a camera, for example with data sheet values (configs/cameras)."""

import dataclasses
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, ClassVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import (
    MAX_BITS,
    MAX_CFA,
    MAX_CHANNELS,
    MAX_GAIN,
    MAX_MASKED,
    MIN_EXPOSURE,
    AnalogGains,
    CameraModel,
    MaskedPixels,
    Noise,
    Optics,
    Polarisers,
    Readout,
    check_sensor,
)
from l3cli.artifacts.camera_curves import ResponsivityRecipe, curve_faults, curve_table, differences, responsivity
from l3cli.artifacts.recipe_source import RecipeSource
from l3cli.artifacts.schema import Spec, declared, is_stored
from l3cli.artifacts.store import load
from l3cli.errors import InputFileError, RecipeError, raised_as, suggestion
from l3cli.recipes.builtin import known_recipes
from l3cli.recipes.faults import Fault, fault, refuse_first
from l3cli.recipes.load import load_recipe, parse_recipe
from l3cli.recipes.toml import Count, CountOrNone, NotNegative, Positive, Recipe, Seed, parse_toml, read_text
from l3cli.spectra.file import read_table
from l3cli.spectra.table import CurveTable

UNIT_SUFFIXES = {"1": "", "e-": "_e", "e-/s": "_e_per_s"}  # suffix of the recipe keys with each unit
MAX_READ_NOISE_E = 1e4
MAX_ISO = 1e7
PITCHES_UM, MIN_F_NUMBER, MIN_FOCAL_MM = (0.1, 1000.0), 0.5, 0.05  # values beyond these limits probably have a wrong unit
PITCH_UM, FOCAL_MM, F_NUMBER = 5.0, 50.0, 4.0  # assumed for a camera of which l3 has only a raw file
MAX_PRNU = 0.2  # a larger PRNU cannot be corrected
Bits = Annotated[int, msgspec.Meta(ge=1, le=MAX_BITS)]
Masked = Annotated[int, msgspec.Meta(ge=0, le=MAX_MASKED)]
ReadNoise = Annotated[float, msgspec.Meta(ge=0, le=MAX_READ_NOISE_E)]


class ChannelRecipe(Recipe):
    """Section [channel.NAME], which sets the exposure, gain, read noise, polariser or shared filter of a channel.

    Channels with the default values need no section.
    """

    like: str | None = None  # name of a channel with the same filter and therefore the same responsivity
    # exposure time relative to the longest exposure time of all channels, which is the exposure time of the frame
    exposure: Annotated[float, msgspec.Meta(ge=MIN_EXPOSURE, le=1)] = 1.0
    # conversion gain, relative to sensor.gain_dn_per_e, which is the lowest conversion gain of all channels
    gain: Annotated[float, msgspec.Meta(ge=1, le=MAX_GAIN)] = 1.0
    read_noise_e: ReadNoise | None = None  # read noise at the gain of the channel; default: noise.read_noise_e
    # angle of the polariser's transmission axis, counter-clockwise from the horizontal axis of the frame. If the angle is
    # set, the responsivity applies to light polarised along this axis. Default: no polariser
    polariser_deg: Annotated[float, msgspec.Meta(ge=0, lt=180)] | None = None
    # extinction ratio of the polariser: transmission along its axis divided by transmission across it. Either a number, or a
    # CSV file with wavelengths in nm and ratios. Default: an ideal polariser
    extinction: Annotated[float, msgspec.Meta(ge=1)] | str | None = None

    @property
    def read_out_differently(self) -> bool:
        """Whether the exposure, the gain or the read noise differs from the defaults."""
        return (self.exposure, self.gain, self.read_noise_e) != (1.0, 1.0, None)


def channel_faults(channel: Mapping[str, ChannelRecipe], channels: Sequence[str]) -> Iterator[Fault]:
    """Find the faults in the sections [channel.NAME].

    Unknown channels and contradictory settings are faults. It is also a fault if no channel has the exposure 1.
    """
    for name, one in channel.items():
        if name not in channels:
            yield fault(f'"{name}" is not a channel of cfa.channels; {suggestion(name, channels)}', ("channel", name))
        if one.extinction is not None and one.polariser_deg is None:
            message = f"channel.{name}.extinction has no effect without a polariser; set channel.{name}.polariser_deg too"
            yield fault(message, ("channel", name, "extinction"))
        if one.like is None:
            continue
        like = ("channel", name, "like")
        if one.like not in channels:
            message = f'channel.{name}.like: "{one.like}" is not a channel of cfa.channels; {suggestion(one.like, channels)}'
            yield fault(message, like)
        elif one.like == name or (one.like in channel and channel[one.like].like is not None):
            message = (
                f'channel.{name}.like is "{one.like}", a channel without its own curve; write the name of a channel with '
                "its own curve"
            )
            yield fault(message, like)
        elif channels.index(one.like) > (channels.index(name) if name in channels else len(channels)):
            message = f'channel.{name}.like is "{one.like}"; write "{one.like}" before "{name}" in cfa.channels'
            yield fault(message, like, "cfa.channels")
    if channel and channels and max(channel.get(name, ChannelRecipe()).exposure for name in channels) < 1:
        message = "no channel has the exposure 1; write each exposure as a fraction of the longest exposure"
        yield fault(message, *(("channel", name, "exposure") for name in channel))


def filters_of(channel: Mapping[str, ChannelRecipe], channels: Sequence[str]) -> list[str]:
    """Return the name of the channel that defines each channel's filter: `like`, or by default the channel itself."""
    return [(channel[name].like if name in channel else None) or name for name in channels]


def settings_of(readout: Readout | None, channels: Sequence[str]) -> dict[str, ChannelRecipe]:
    """Return the sections [channel.NAME] that describe a readout, except for its read noise.

    Channels with default values have no section. If `readout` is None, the result is empty.
    """
    if readout is None:
        return {}
    rows = zip(channels, readout.same_filter, readout.channel_exposure, readout.channel_gain, strict=True)
    each = {
        name: ChannelRecipe(None if channels[first] == name else channels[first], float(exposure), float(gain))
        for name, first, exposure, gain in rows
    }
    return {name: one for name, one in each.items() if one != ChannelRecipe()}


def settings_from(channel: Mapping[str, ChannelRecipe], channels: Sequence[str], path: Path) -> Readout | None:
    """Check the sections [channel.NAME] of a measurement file, and return the readout that they describe.

    A channel without `read_noise_e` gets a read noise of 0. The result is None if the channels do not differ in readout
    (see `readout_of`).

    Raises
    ------
    RecipeError
        If `channel_faults` finds a fault. The message begins with `path`.
    """
    refuse_first(channel_faults(channel, channels), path)
    return readout_of(channel, channels, 0.0)


def readout_of(channel: Mapping[str, ChannelRecipe], channels: Sequence[str], read_noise: float) -> Readout | None:
    """Return the readout that the sections [channel.NAME] of a valid recipe describe.

    The default read noise of a channel is `read_noise`, in e-. The result is None if the recipe has no such sections, or if
    they describe polarisers without any difference in readout.
    """
    if not _read_out_differently(channel):
        return None
    each = [channel.get(name, ChannelRecipe()) for name in channels]
    return Readout(
        channel_exposure=np.array([one.exposure for one in each]),
        channel_gain=np.array([one.gain for one in each]),
        channel_read_noise=np.array([read_noise if one.read_noise_e is None else one.read_noise_e for one in each]),
        same_filter=np.array([channels.index(name) for name in filters_of(channel, channels)]),
    )


def _read_out_differently(channel: Mapping[str, ChannelRecipe]) -> bool:
    """Return whether the sections [channel.NAME] describe differences between channels other than their polarisers."""
    polarised = any(one.polariser_deg is not None for one in channel.values())
    return bool(channel) and (not polarised or any(one.read_out_differently for one in channel.values()))


def polarisers_of(
    channel: Mapping[str, ChannelRecipe], channels: Sequence[str], wavelength: NDArray[np.float64], folder: Path
) -> Polarisers | None:
    """Return the polarisers that a recipe describes, or None if no channel has a polariser.

    Parameters
    ----------
    channel : mapping of str to ChannelRecipe
        Sections [channel.NAME] that have passed `channel_faults`.
    channels : sequence of str
        Names of all channels.
    wavelength : ndarray, (wavelength,)
        Wavelengths of the camera in nm.
    folder : Path
        Folder of the recipe. Paths in the recipe are relative to this folder.

    Raises
    ------
    InputFileError
        If a file with extinction ratios is missing, contains more than one curve, or contains a ratio below 1.
    """
    each = [channel.get(name, ChannelRecipe()) for name in channels]
    if all(one.polariser_deg is None for one in each):
        return None
    return Polarisers(
        polariser_deg=np.array([one.polariser_deg or 0.0 for one in each]),
        leakage=np.array([_leakage(one, wavelength, folder) for one in each]),
    )


def _leakage(one: ChannelRecipe, wavelength: NDArray[np.float64], folder: Path) -> NDArray[np.float64]:
    """Return a channel's leakage, the inverse of its extinction ratio, at each wavelength.

    The leakage is 1 without a polariser, and 0 for an ideal polariser, which is the default. Raises InputFileError if the
    file with extinction ratios contains a ratio below 1.
    """
    if one.polariser_deg is None:
        return np.ones_like(wavelength)
    if not isinstance(one.extinction, str):
        return np.full(wavelength.shape, 0.0 if one.extinction is None else 1.0 / one.extinction)
    path = folder / one.extinction
    table = read_table(path).counted(1)
    if table.values.min() < 1:
        raise InputFileError(
            f"{path} contains the extinction ratio {table.values.min():g}, but the smallest possible ratio is 1; write "
            "transmission along the axis divided by transmission across the axis"
        )
    return np.asarray(1.0 / np.interp(wavelength, table.wavelength, table.values[0]))


class SensorRecipe(Recipe):
    rows: Count
    cols: Count
    pixel_pitch_um: Positive
    bits: Bits
    black_level_dn: float
    gain_dn_per_e: Positive | None = None  # default: the gain at which a full well reaches the white level
    white_level_dn: float | None = None  # default: the raw value of a full well, clipped to the range of the converter
    fixed_pattern_seed: Seed = 0


class CfaRecipe(Recipe):
    """Section [cfa]: the colour filter array."""

    channels: list[str]
    pattern: list[str]  # rows of the super-pixel; each row contains channel names, separated by spaces


class NoiseRecipe(Recipe):
    """Section [noise]: the noise of the sensor at the gain sensor.gain_dn_per_e."""

    well_capacity_e: Positive
    read_noise_e: NotNegative = 0.0
    dark_current_e_per_s: NotNegative = 0.0
    dsnu_e: NotNegative = 0.0
    prnu: NotNegative = 0.0
    column_noise_e: NotNegative = 0.0  # standard deviation of the fixed column offsets
    row_temporal_noise_e: NotNegative = 0.0  # standard deviation of the row offsets that change from frame to frame
    column_temporal_noise_e: NotNegative = 0.0  # standard deviation of the column offsets that change from frame to frame
    row_noise_e: NotNegative = 0.0  # standard deviation of the fixed row offsets
    row_prnu: NotNegative = 0.0  # relative standard deviation of the response that all pixels of a row share
    column_prnu: NotNegative = 0.0  # relative standard deviation of the response that all pixels of a column share


def noise_of(recipe: NoiseRecipe) -> Noise:
    """Convert the [noise] section of a recipe to the noise of a camera model."""
    return Noise(**{name: getattr(recipe, key) for name, key in noise_keys().items()})


def noise_entries(noise: Noise) -> dict[str, float]:
    """Convert the noise of a camera model to keys and values of the [noise] section of a recipe: the inverse of `noise_of`.

    Optional keys are omitted if they are zero.
    """
    fields = dict(declared(Noise))
    return {
        key: getattr(noise, name)
        for name, key in noise_keys().items()
        if isinstance(spec := fields[name], Spec) and is_stored(noise, name, spec)
    }


def noise_keys() -> dict[str, str]:
    """Return the recipe key for each field of `Noise`: the field's name with a suffix for its unit."""
    return {name: f"{name}{UNIT_SUFFIXES[spec.unit]}" for name, spec in declared(Noise) if isinstance(spec, Spec)}


class GainRecipe(Recipe):
    """Section [gain]: the read noise at other analog gains (docs/method.md#gains)."""

    iso: Annotated[float, msgspec.Meta(ge=0, le=MAX_ISO)] = 0.0  # ISO setting for sensor.gain_dn_per_e; 0 if unknown
    # gains at which the read noise is known, relative to sensor.gain_dn_per_e
    gains: tuple[Annotated[float, msgspec.Meta(ge=1 / MAX_GAIN, le=MAX_GAIN)], ...] = ()
    read_noise_e: tuple[ReadNoise, ...] = ()  # read noise at each gain in `gains`
    # Part of noise.read_noise_e that arises before the amplifier; the rest arises after the amplifier. Use this key instead
    # of `gains` and `read_noise_e`.
    read_noise_before_e: NotNegative | None = None


def gains_of(recipe: GainRecipe | None, read_noise: float) -> AnalogGains | None:
    """Convert a valid [gain] section to the gains of a camera model. Returns None if the recipe has no such section.

    `read_noise` is the read noise at sensor.gain_dn_per_e, in e-.
    """
    if recipe is None:
        return None
    known = dict(zip(recipe.gains, recipe.read_noise_e, strict=True))
    if recipe.read_noise_before_e is not None:
        known = {
            gain: np.hypot(recipe.read_noise_before_e, np.sqrt(read_noise**2 - recipe.read_noise_before_e**2) / gain)
            for gain in (1 / MAX_GAIN, MAX_GAIN)
        }
    each = sorted(known)
    return AnalogGains(np.array(each, np.float64), np.array([known[gain] for gain in each], np.float64), recipe.iso)


def gain_faults(recipe: GainRecipe, read_noise: float) -> Iterator[Fault]:
    """Find the faults in the [gain] section. `read_noise` is the camera's read noise in e-."""
    if len(recipe.gains) != len(recipe.read_noise_e):
        message = f"gain.gains has {len(recipe.gains)} values, but gain.read_noise_e has {len(recipe.read_noise_e)}"
        yield fault(f"{message}; write one read noise per gain", "gain.read_noise_e", "gain.gains")
    for gain in recipe.gains:
        if gain == 1 or recipe.gains.count(gain) > 1:
            reason = "1, for which noise.read_noise_e already applies" if gain == 1 else f"{gain:g} more than once"
            yield fault(f"gain.gains contains {reason}; remove this value", "gain.gains")
    before = recipe.read_noise_before_e
    if before is not None and recipe.gains:
        message = "[gain] sets read_noise_before_e and gains; set either read_noise_before_e, or gains and read_noise_e"
        yield fault(message, "gain.read_noise_before_e", "gain.gains")
    elif before is not None and before > read_noise:
        message = (
            f"gain.read_noise_before_e is {before:g}, but must not exceed noise.read_noise_e, which is {read_noise:g}; "
            "decrease gain.read_noise_before_e"
        )
        yield fault(message, "gain.read_noise_before_e")


class MaskedRecipe(Recipe):
    """Section [masked]: optically black rows and columns around the sensor.rows × sensor.cols light-sensitive pixels."""

    left: Masked = 0  # columns to the left of the light-sensitive pixels
    right: Masked = 0
    top: Masked = 0  # rows above the light-sensitive pixels
    bottom: Masked = 0


def masked_recipe(masked: MaskedPixels | None) -> MaskedRecipe | None:
    """Return the [masked] section that describes the masked pixels of a camera model: the inverse of `masked_of`."""
    return None if masked is None else MaskedRecipe(*dataclasses.astuple(masked))


def masked_of(recipe: MaskedRecipe | None) -> MaskedPixels | None:
    """Return the masked pixels that the [masked] section describes, or None if there is no such section."""
    return None if recipe is None else MaskedPixels(**msgspec.structs.asdict(recipe))


def masked_faults(recipe: MaskedRecipe | None, channels: Mapping[str, ChannelRecipe]) -> Iterator[Fault]:
    """Find the faults in the [masked] section, including conflicts with the [channel.NAME] sections in `channels`."""
    if recipe is None:
        return
    if not any(msgspec.structs.astuple(recipe)):
        yield fault("[masked] contains no masked pixels; set left, right, top or bottom, or remove [masked]", "masked")
    if _read_out_differently(channels):
        message = "[masked] cannot be combined with channels that differ in exposure, gain or read noise; remove [masked]"
        yield fault(message, "masked")


class OpticsRecipe(Recipe):
    focal_length_mm: Positive
    f_number: Positive
    object_distance_m: NotNegative = 0.0  # 0: infinity


def optics_of(recipe: OpticsRecipe) -> Optics:
    """Convert the [optics] section of a recipe to the optics of a camera model."""
    return Optics(
        focal_length=recipe.focal_length_mm * 1e-3,
        f_number=recipe.f_number,
        object_distance=recipe.object_distance_m,
    )


def optics_recipe(optics: Optics) -> OpticsRecipe:
    """Convert the optics of a camera model to an [optics] section: the inverse of `optics_of`."""
    return OpticsRecipe(
        focal_length_mm=round(optics.focal_length * 1e3, 9),
        f_number=optics.f_number,
        object_distance_m=optics.object_distance,
    )


class CameraRecipe(Recipe):
    """A complete camera recipe (configs/cameras)."""

    title: ClassVar[str] = "a camera recipe"

    name: str
    sensor: SensorRecipe
    cfa: CfaRecipe
    responsivity: ResponsivityRecipe
    noise: NoiseRecipe
    optics: OpticsRecipe
    channel: dict[str, ChannelRecipe] = msgspec.field(default_factory=dict)  # exposure, gain or polariser of single channels
    gain: GainRecipe | None = None  # read noise of the whole sensor at other analog gains
    masked: MaskedRecipe | None = None  # optically black pixels around the light-sensitive pixels


class PhaseRecipe(Recipe):
    """A short recipe that copies a base recipe and shifts its colour filter array."""

    title: ClassVar[str] = CameraRecipe.title

    name: str
    base: str  # path of the base recipe, relative to the folder of this recipe
    phase: tuple[CountOrNone, CountOrNone]  # row and column of the base array at which the shifted array begins


def load_camera(path: Path) -> CameraModel:
    """Load a camera model from an artifact (.h5), or compute it from a camera recipe (.toml)."""
    if path.suffix == ".toml":
        return camera_from_recipe(*read_recipe(path))
    return load(CameraModel, path)


def camera_files(path: Path) -> list[Path]:
    """List the files that `load_camera` reads, without duplicates.

    For a recipe, these are the recipe, its base recipe, and the CSV files with responsivities and extinction ratios.
    """
    if path.suffix != ".toml":
        return [path]
    recipe, whole = read_recipe(path)
    curves = [one.extinction for one in recipe.channel.values() if isinstance(one.extinction, str)]
    named = [*([] if recipe.responsivity.file is None else [recipe.responsivity.file]), *curves]
    return list(dict.fromkeys([path, whole, *(whole.parent / name for name in named)]))


def curves_in_file(path: Path) -> CurveTable | None:
    """Read the responsivity file of a camera recipe.

    Returns None if `path` is not a recipe (.toml), or if the recipe describes its responsivities with Gaussians.
    """
    if path.suffix != ".toml":
        return None
    recipe, whole = read_recipe(path)
    if recipe.responsivity.file is None:
        return None
    return curve_table(recipe.responsivity, _filters(recipe), whole.parent)


def columns_left_out(path: Path) -> str | None:
    """Return a note about unused columns in the responsivity file of a camera recipe.

    Returns None if each column matches a channel, or if the recipe has no responsivity file.
    """
    curves = curves_in_file(path)
    return None if curves is None else curves.note


def _filters(recipe: CameraRecipe) -> list[str]:
    """Return the names of the channels that define a filter, without duplicates."""
    return list(dict.fromkeys(filters_of(recipe.channel, recipe.cfa.channels)))


def read_recipe(path: Path) -> tuple[CameraRecipe, Path]:
    """Read a camera recipe. A recipe with a base is expanded to a complete recipe.

    Returns
    -------
    recipe : CameraRecipe
        The complete recipe. If there is a base, this is the base recipe with the new name and the shifted array.
    path : Path
        The file with the complete recipe: the base if there is one, otherwise `path`.

    Raises
    ------
    RecipeError
        If the recipe or its base has a fault, or if the phase is outside the base array.
    """
    text, name = read_text(path, CameraRecipe.title), str(path)
    if "base" not in parse_toml(text, name):
        return parse_recipe(text, CameraRecipe, name), path
    variant = parse_recipe(text, PhaseRecipe, name)
    whole = path.parent / variant.base
    base = load_recipe(whole, CameraRecipe)
    period, (row, col) = parse_cfa(base.cfa, str(whole)).shape, variant.phase
    if row >= period[0] or col >= period[1]:
        raise RecipeError(
            f"{path}: phase is [{row}, {col}], but the array in {whole} has only {period[0]}×{period[1]} sites; write a row "
            "and a column inside this array, counted from 0"
        )
    lines = [line.split() for line in base.cfa.pattern]
    pattern = [" ".join(line[col:] + line[:col]) for line in lines[row:] + lines[:row]]
    cfa = CfaRecipe(base.cfa.channels, pattern)
    return msgspec.structs.replace(base, name=variant.name, cfa=cfa), whole


def camera_from_recipe(recipe: CameraRecipe, path: Path) -> CameraModel:
    """Compute a camera model from a recipe.

    Parameters
    ----------
    recipe : CameraRecipe
        A complete recipe.
    path : Path
        Path of the recipe file. Paths in the recipe are relative to its folder, and error messages name it.

    Raises
    ------
    RecipeError
        If the recipe contains impossible or contradictory values.
    InputFileError
        If a file with responsivities or extinction ratios is missing or unusable.
    """
    refuse_first(camera_faults(recipe), path)
    sensor, noise = recipe.sensor, recipe.noise
    filters = _filters(recipe)
    wavelength, curves = responsivity(recipe.responsivity, filters, path.parent)
    curves = curves[[filters.index(each) for each in filters_of(recipe.channel, recipe.cfa.channels)]]
    with raised_as(RecipeError, path):
        return CameraModel(
            name=recipe.name,
            rows=sensor.rows,
            cols=sensor.cols,
            pixel_pitch=sensor.pixel_pitch_um * 1e-6,
            bits=sensor.bits,
            channels=tuple(recipe.cfa.channels),
            cfa=parse_cfa(recipe.cfa, str(path)),
            wavelength=wavelength,
            responsivity=curves,
            responsivity_band=np.zeros_like(curves),
            absolute=True,
            gain=gain_of(recipe),
            black_level=sensor.black_level_dn,
            white_level=white_level(recipe),
            fixed_pattern_seed=sensor.fixed_pattern_seed,
            noise=noise_of(noise),
            optics=optics_of(recipe.optics),
            readout=readout_of(recipe.channel, recipe.cfa.channels, noise.read_noise_e),
            gains=gains_of(recipe.gain, noise.read_noise_e),
            polarisers=polarisers_of(recipe.channel, recipe.cfa.channels, wavelength, path.parent),
            masked=masked_of(recipe.masked),
        )


def camera_faults(recipe: CameraRecipe) -> Iterator[Fault]:
    """Find the faults in a recipe. The content of the files that it uses is not checked."""
    sensor, noise, optics = recipe.sensor, recipe.noise, recipe.optics
    if recipe.responsivity.peak_efficiency is not None:
        yield from share_faults(recipe.responsivity.peak_efficiency, "responsivity.peak_efficiency", 1.0)
    if recipe.gain is not None:
        yield from gain_faults(recipe.gain, noise.read_noise_e)
    yield from relative_noise_faults(noise, "noise")
    yield from length_faults(sensor.pixel_pitch_um, optics)
    yield from cfa_faults(recipe.cfa)
    yield from masked_faults(recipe.masked, recipe.channel)
    yield from channel_faults(recipe.channel, recipe.cfa.channels)
    yield from curve_faults(recipe.responsivity, _filters(recipe))
    yield from _model_faults(recipe)


def relative_noise_faults(noise: NoiseRecipe, section: str) -> Iterator[Fault]:
    """Find relative noise values, such as PRNU, that are too large to be corrected, in the section `section` of a recipe."""
    for key in ("prnu", "row_prnu", "column_prnu"):
        yield from share_faults(getattr(noise, key), f"{section}.{key}", MAX_PRNU)


def _model_faults(recipe: CameraRecipe) -> Iterator[Fault]:
    """Find contradictions between the sensor's size, bit depth and levels."""
    sensor = recipe.sensor
    black, white = sensor.black_level_dn, white_level(recipe)
    try:
        check_sensor(sensor.rows, sensor.cols, sensor.bits, black, white)
    except ValueError as error:
        named = ("rows", "cols") if black < white else ("black_level_dn", "white_level_dn", "gain_dn_per_e")
        yield fault(str(error), *(f"sensor.{key}" for key in (*named, "bits", "rows", "cols")), "noise.well_capacity_e")


def white_level(recipe: CameraRecipe) -> float:
    """Return the raw value of a saturated pixel in DN.

    This is `white_level_dn` if the recipe contains it. Otherwise it is the raw value at the full-well capacity or the
    largest value of the analog-to-digital converter, whichever is lower.
    """
    sensor = recipe.sensor
    if sensor.white_level_dn is not None:
        return sensor.white_level_dn
    if sensor.gain_dn_per_e is None:
        return float(2**sensor.bits - 1)
    well = np.floor(sensor.black_level_dn + sensor.gain_dn_per_e * recipe.noise.well_capacity_e)
    return float(min(2**sensor.bits - 1, well))


def gain_of(recipe: CameraRecipe) -> float:
    """Return the conversion gain of the camera that a valid recipe describes, in DN/e-.

    If the recipe does not contain a gain, this is the gain at which a full well reaches the white level.
    """
    if recipe.sensor.gain_dn_per_e is not None:
        return recipe.sensor.gain_dn_per_e
    return (white_level(recipe) - recipe.sensor.black_level_dn) / recipe.noise.well_capacity_e


def share_faults(value: float, key: str, most: float) -> Iterator[Fault]:
    """Find a fraction that exceeds `most`. If `value` is probably a percentage, the message suggests the fraction."""
    if value > most:
        percent = f"; {value:g} % is {value / 100:g}" if value <= 100 * most else ""
        yield fault(f"{key} is {value:g}; write a fraction of at most {most:g}{percent}", key)


def length_faults(pitch_um: float, optics: OpticsRecipe) -> Iterator[Fault]:
    """Find pixel pitches and focal lengths in a probably wrong unit, and impossible f-numbers and object distances."""
    least, most = PITCHES_UM
    if not least <= pitch_um <= most:
        meant = next(
            (f"; did you mean {pitch_um * each:g}?" for each in (1e3, 1e6, 1e-3) if least <= pitch_um * each <= most), ""
        )
        message = f"sensor.pixel_pitch_um is {pitch_um:g}, but must be between {least:g} and {most:g} µm{meant}"
        yield fault(message, "sensor.pixel_pitch_um")
    focal, f_number = optics.focal_length_mm, optics.f_number
    if focal < MIN_FOCAL_MM:
        message = (
            f"optics.focal_length_mm is {focal:g}, but must be at least {MIN_FOCAL_MM:g} mm; did you mean {focal * 1000:g}?"
        )
        yield fault(message, "optics.focal_length_mm")
    if f_number < MIN_F_NUMBER:
        message = f"optics.f_number is {f_number:g}, but a lens in air has at least {MIN_F_NUMBER}; correct the f-number"
        yield fault(message, "optics.f_number")
    if 0 < optics.object_distance_m <= focal * 1e-3:
        message = (
            f"optics.object_distance_m is {optics.object_distance_m:g}, which is not larger than the focal length; write "
            "the distance in m, or 0 for infinity"
        )
        yield fault(message, "optics.object_distance_m", "optics.focal_length_mm")


def cfa_faults(cfa: CfaRecipe) -> Iterator[Fault]:
    """Find the faults in a colour filter array.

    The rows must have the same length, the array and the number of channels must not be too large, and the pattern must
    contain exactly the listed channels, each listed once.
    """
    rows = [row.split() for row in cfa.pattern]
    even = bool(rows and rows[0]) and all(len(row) == len(rows[0]) for row in rows)
    if not even:
        message = "the rows of cfa.pattern have different lengths; write the same number of channel names in each row"
        yield fault(message, "cfa.pattern")
    elif len(rows) > MAX_CFA or len(rows[0]) > MAX_CFA:
        message = (
            f"cfa.pattern has {len(rows)}×{len(rows[0])} sites, but at most {MAX_CFA}×{MAX_CFA} are supported; shorten it"
        )
        yield fault(message, "cfa.pattern")
    if len(cfa.channels) > MAX_CHANNELS or len(set(cfa.channels)) != len(cfa.channels):
        yield fault(f"cfa.channels must contain at most {MAX_CHANNELS} different names", "cfa.channels")
    used = {channel for row in rows for channel in row}
    if even and used != set(cfa.channels):
        message = f"cfa.channels and cfa.pattern contain different channels: {differences(used, cfa.channels)}"
        yield fault(message, "cfa.pattern", "cfa.channels")


def parse_cfa(cfa: CfaRecipe, name: str) -> NDArray[np.uint8]:
    """Convert a colour filter array to channel indices, with the shape (cfa_row, cfa_col).

    Raises
    ------
    RecipeError
        If `cfa_faults` finds a fault. The message begins with `name`.
    """
    refuse_first(cfa_faults(cfa), name)
    rows = [row.split() for row in cfa.pattern]
    return np.array([[cfa.channels.index(channel) for channel in row] for row in rows], dtype=np.uint8)


def known_arrays() -> dict[str, CfaRecipe]:
    """Return the colour filter arrays of the camera recipes included with l3, by recipe name.

    Arrays with polarisers come last, because the mean signals of a frame cannot distinguish polarisers from colour filters.
    """
    found = {name: tomllib.loads(path.read_text(encoding="utf-8")) for name, path in known_recipes("cameras").items()}
    found = dict(sorted(found.items(), key=lambda each: "polariser_deg" in str(each[1].get("channel"))))
    arrays = {name: recipe.get("cfa", {}) for name, recipe in found.items()}
    return {name: CfaRecipe(**cfa) for name, cfa in arrays.items() if {"channels", "pattern"} <= cfa.keys()}


def recipe_text(path: Path) -> str:
    """Return the text of a recipe, followed by the text of its base if there is one.

    Artifacts store this text in their history. If `path` is not a recipe (.toml), the text is empty.
    """
    if path.suffix != ".toml":
        return ""
    return "\n".join(read_text(file) for file in dict.fromkeys([path, read_recipe(path)[1]]))


def camera_recipe_faults(recipe: CameraRecipe | PhaseRecipe, source: RecipeSource) -> Iterator[Fault]:
    """Find all faults in a camera recipe and in its CSV files with responsivities and extinction ratios."""
    if source.path.suffix != ".toml":
        message = f'the name of a camera recipe must end in ".toml"; rename {source.path.name} to NAME.toml'
        yield fault(message, "name")
    if isinstance(recipe, PhaseRecipe):
        return
    wrong = list(camera_faults(recipe))
    yield from wrong
    declared = recipe.responsivity
    if declared.file is not None:
        work = (responsivity, declared, recipe.cfa.channels, source.path.parent)
        if not any(each.keys[0][0] in ("responsivity", "cfa") for each in wrong):
            yield from source.attempt(("responsivity", "file"), *work)
    for name, one in recipe.channel.items():
        if isinstance(one.extinction, str) and one.polariser_deg is not None:
            yield from source.attempt(("channel", name, "extinction"), _leakage, one, np.zeros(1), source.path.parent)
