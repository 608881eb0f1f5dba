"""Write a camera recipe and its responsivity file for a camera known from raw files or from l3's list of cameras.

Comments in the recipe mark assumed values.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import MAX_GAIN
from l3cli.artifacts.camera_recipe import F_NUMBER, FOCAL_MM, MIN_F_NUMBER, MIN_FOCAL_MM, PITCH_UM
from l3cli.frames.measurement import Body, FinishedCurves, Stated
from l3cli.physics.mosaic import array_rows
from l3cli.recipes.builtin import CURVES
from l3cli.recipes.toml import toml_value
from l3cli.system.text import printable

PEAK_EFFICIENCY = 0.4  # typical peak quantum efficiency of a silicon camera with its lens
ELECTRONS_PER_UM2 = 1500.0  # typical full-well capacity per µm² at ISO 100
BASE_ISO = 100.0  # typical lowest ISO speed
READ_NOISE_E = 3.0  # e-; typical read noise
# Gains in the recipe of a camera without raw files, relative to the gain at the lowest ISO speed.
USUAL_GAINS = (4.0, 16.0, 64.0)
FEWEST_ELECTRONS = 100.0  # e-; smallest plausible full scale
Array = NDArray[np.floating]


@dataclass(frozen=True)
class SensorNoise:
    """Gain and read noise at a photo's ISO speed, and a description of their source."""

    gain: float  # DN/e-
    read_noise_e: float
    source: str


@dataclass(frozen=True)
class PhotoCamera:
    """Data about a camera, from its raw files or, if there are none, from l3's list of cameras."""

    photo: Path | None  # raw file; None if only the name of the camera is known
    body: Body
    black_level: float  # DN
    white_level: float  # DN
    stated: Stated
    wavelength: Array  # (wavelength,): nm
    curves: Array  # (channel, wavelength): response per photon, divided by the highest peak of all channels
    origin: str  # source of the curves, for a comment in the recipe
    noise: SensorNoise
    white: str | None = None  # value of ‹white› for rendering the photo: the specified illuminant or the chart's illuminant
    # other gains, relative to the photo's gain, and the read noise (e-) at each gain
    gains: tuple[tuple[float, float], ...] = ()
    overrides: Mapping[str, str] = field(default_factory=dict)  # options of l3 render that correct metadata of the raw files

    def gain_recipe(self) -> str:
        """Return the text of the [gain] section, or an empty string if the ISO speed of the photo is unknown."""
        if self.stated.iso is None:
            return ""
        lines = ["", "[gain]", f"iso = {self.stated.iso:g} # at gain_dn_per_e"]
        if self.gains:
            gains = ", ".join(f"{gain:g}" for gain, _ in self.gains)
            noises = ", ".join(f"{noise:.4g}" for _, noise in self.gains)
            source = "assumed" if self.photo is None else "from the ISO speeds and noise profiles of the remaining files"
            lines += [f"gains = [{gains}] # {source}", f"read_noise_e = [{noises}] # {source}"]
        return "\n".join(lines) + "\n"

    @property
    def name(self) -> str:
        return self.stated.camera or self.body.name

    @property
    def assumed(self) -> list[str]:
        """Names of the quantities with assumed values."""
        known = self.stated
        names = {"pixel pitch": known.pitch_um, "focal length": self._focal_mm, "f-number": self._f_number}
        return ["peak efficiency", *(name for name, value in names.items() if value is None)]

    @property
    def _focal_mm(self) -> float | None:
        value = self.stated.focal_length_mm
        return value if value is not None and value >= MIN_FOCAL_MM else None

    @property
    def _f_number(self) -> float | None:
        value = self.stated.f_number
        return value if value is not None and value >= MIN_F_NUMBER else None

    def recipe(self) -> str:
        """Return the text of the camera recipe, with comments on the source of each value."""
        body = self.body
        known = "from its name only" if self.photo is None else f"from the raw file {self.photo.name}"
        source = "nominal; raw files contain the actual values" if self.photo is None else "from the raw file"
        rows = "\n".join(f'  "{row}",' for row in array_rows(body.channels, body.cfa))
        pitch, full = self.stated.pitch_um, (self.white_level - self.black_level) / self.noise.gain
        return f"""\
# {printable(f"{self.name}, {known}")}. Values that are not known are marked as assumed. If you
# know better values, correct them.
name = {toml_value(self.name)}

[sensor] # size, bits and levels: {source}
rows = {body.rows}
cols = {body.cols}
pixel_pitch_um = {pitch or PITCH_UM:.4g}{"" if pitch else " # assumed"}
bits = {body.bits}
gain_dn_per_e = {self.noise.gain:.4g} # {self.noise.source}; {full:.3g} e- at full scale
black_level_dn = {self.black_level:g}
white_level_dn = {self.white_level:g}

[cfa] # the first pixel of a frame has the first filter
channels = {toml_value(body.channels)}
pattern = [
{rows}
]

[responsivity] # {printable(self.origin)}
file = "{CURVES}"
peak_efficiency = {PEAK_EFFICIENCY} # assumed, because the curves are relative; includes lens and filters

[noise] # dark current, DSNU and PRNU are assumed to be 0; to measure them, use l3 calibrate
read_noise_e = {self.noise.read_noise_e:.4g} # {self.noise.source}
well_capacity_e = {full:.6g}

[optics]
focal_length_mm = {self._focal_mm or FOCAL_MM:.4g}{"" if self._focal_mm else " # assumed"}
f_number = {self._f_number or F_NUMBER:.3g}{"" if self._f_number else " # assumed"}
{self.gain_recipe()}"""

    def curve_file(self) -> str:
        """Return the text of a CSV file with the relative curves per photon."""
        heading = ",".join(["wavelength_nm", *self.body.channels])
        lines = (
            f"{at:g}," + ",".join(f"{value:.5f}" for value in row)
            for at, row in zip(self.wavelength, self.curves.T, strict=True)
        )
        return "\n".join([heading, *lines]) + "\n"


def without_photo(
    body: Body, levels: tuple[float, float], known: Stated, curves: FinishedCurves, origin: str
) -> PhotoCamera:
    """Collect the data of a camera in l3's list of cameras, without a photo.

    Parameters
    ----------
    body : Body
        Sensor, filter array and optics.
    levels : tuple of float
        Black level and white level in DN.
    known : Stated
        Data about the camera from the list of cameras.
    curves : FinishedCurves
        Responsivities of the camera.
    origin : str
        Source of the curves, for a comment in the recipe.
    """
    noise = noise_of(known, levels[1] - levels[0])
    gains = tuple((gain, noise.read_noise_e) for gain in USUAL_GAINS) if known.iso else ()
    return PhotoCamera(None, body, *levels, known, curves.wavelength, curves.responsivity, origin, noise, gains=gains)


def gains_of(known: Stated, others: Sequence[Stated]) -> tuple[tuple[float, float], ...]:
    """Compute gains and read noise from the noise profiles of raw files with higher ISO speeds.

    Parameters
    ----------
    known : Stated
        Metadata of the raw file to which the gains are relative.
    others : sequence of Stated
        Metadata of additional raw files. A file is ignored if it lacks a noise profile or an ISO speed, if its ISO speed is
        not higher, or if its gain is too large for a camera recipe.

    Returns
    -------
    tuple of (float, float)
        Gain and read noise in electrons, sorted by gain.
    """
    found: dict[float, float] = {}
    for each in others:
        if known.iso and each.iso and each.noise is not None and 1 < each.iso / known.iso <= MAX_GAIN:
            slope, constant = each.noise
            found.setdefault(each.iso / known.iso, float(np.sqrt(constant)) / slope)
    return tuple(sorted(found.items()))


def noise_of(stated: Stated, span: float) -> SensorNoise:
    """Compute gain and read noise from a raw file's noise profile.

    Without a noise profile, typical values for the ISO speed are assumed. `span` is the white level minus the black level,
    in DN.
    """
    if stated.noise is not None:
        slope, constant = stated.noise
        return SensorNoise(span * slope, float(np.sqrt(constant)) / slope, "from the noise profile of the file")
    share = BASE_ISO / max(stated.iso or BASE_ISO, BASE_ISO)
    full = max(ELECTRONS_PER_UM2 * (stated.pitch_um or PITCH_UM) ** 2 * share, FEWEST_ELECTRONS)
    where = f"ISO {stated.iso:g}" if stated.iso else f"ISO {BASE_ISO:g}"
    return SensorNoise(span / full, READ_NOISE_E, f"assumed, typical at {where}")
