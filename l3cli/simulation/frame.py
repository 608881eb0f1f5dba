"""Training frames: simulated from scenes, or paired from a raw file and a picture of the same scene.

The simulation computes the raw frame that a lens and a sensor record of a scene under an illuminant, and the ideal target
outputs of the same scene (docs/method.md#simulation, docs/method.md#optics).
"""

import functools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, Optics
from l3cli.artifacts.training_set import (
    IgnoredPixels,
    LightSpectrum,
    Shown,
    TrainingFrame,
    TrainingPair,
    TrainingSet,
    TrainingSetReader,
)
from l3cli.errors import InputFileError, raised_as
from l3cli.frames.frame import RawFrame, as_taken
from l3cli.frames.scene import ChannelPicture, Scene
from l3cli.physics import spectra
from l3cli.physics.lens import diffraction_transfer, gaussian_transfer, relative_illumination
from l3cli.simulation import sensor
from l3cli.simulation.light import (
    CAMERA,
    OUTPUTS,
    SCENE_LIGHT,
    XYZ,
    Light,
    Target,
    automatic_exposure,
    electron_weights,
    make_light,
    output_weights,
    photon_weights,
    polarised_weights,
    scene_light,
    stokes_weights,
    white_rates,
)
from l3cli.simulation.recipe import Lens, Pair, SceneRecipe, Shot
from l3cli.simulation.sensor import averaging_exposure, saturating_exposure
from l3cli.simulation.sources import DeadLeaves, WantedScene

PAIR_LIGHT = "picture"  # illuminant name of real pairs, whose pictures are already white-balanced to D65
BRIGHT = 0.9  # pixels above this fraction of full scale may be clipped, and are excluded from the fit of a pair's scale
Array = NDArray[np.floating]
Automatic = Callable[[CameraModel, NDArray[np.float32]], float]  # exposure time in s for a mosaic (row, col) in e-/s
LOW_RANK_ERROR = 5e-5  # largest error of the transfer function at any sampled frequency and wavelength
STRIP_PIXELS = 1 << 16  # pixels of a polarised scene that are projected together, which limits memory use
RADIAL_SAMPLES = 2048  # spatial frequencies at which transfer functions are sampled
# number, size (rows, columns) and seed of the frames on which spectral estimators are trained
DRAWN, DRAWN_SIZE, DRAWN_SEED = 48, (64, 64), 20


def simulate(
    camera: CameraModel,
    scene: Scene | ChannelPicture,
    light: Light,
    exposure: float | Automatic,
    lens: Lens,
    seed: tuple[int, ...],
    target: Target = XYZ,
    noises: str = "all",
) -> TrainingFrame:
    """Simulate one training frame: raw frame, electrons of all channels at full resolution, and target.

    Each scene sample is the mean over the area of one pixel, so frame and target are registered.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    scene : Scene or ChannelPicture
        The scene. For a picture of channel signals, only the sensor is simulated.
    light : Light
        Illuminant of the scene.
    exposure : float or callable
        Exposure time in s, or a function that computes the time from the camera and the mosaic in e-/s.
    lens : Lens
        Diffraction, defocus and vignetting of the lens.
    seed : tuple of int
        Seed of the noise.
    target : Target
        Target outputs, which are computed without lens blur and noise.
    noises : str
        One of `sensor.NOISES`, or the name of a noise model.

    Raises
    ------
    ValueError
        If the exposure is automatic and the camera collects no electrons.

    Notes
    -----
    All steps before the noise are linear, so a single matrix product projects the bands onto outputs and channels. If the
    blur depends on the wavelength, each channel needs a few projections (see `LowRankTransfer`).
    """
    ideal, rates, white = _collected(camera, scene, light, lens, target)
    seconds = exposure(camera, sensor.mosaic(rates, camera.cfa)) if callable(exposure) else exposure
    electrons = rates * np.float32(seconds)
    rng = np.random.default_rng(seed)
    return TrainingFrame(
        electrons=electrons,
        raw=sensor.expose(camera, sensor.mosaic(electrons, camera.cfa), seconds, rng, noises),
        target=ideal,
        white=white,
        scene=scene.name,
        illuminant=light.name,
        luminance=light.luminance,
        exposure=seconds,
        light=light.spectrum,
        seed=seed,
        shown=Shown(scene.fingerprint, light.measured),
        ignored=_ignored(scene),
    )


def _ignored(scene: Scene | ChannelPicture) -> IgnoredPixels | None:
    mask = scene.ignored if isinstance(scene, Scene) else None
    return None if mask is None else IgnoredPixels(mask.astype(np.uint8))


def exposed_again(frame: TrainingFrame, camera: CameraModel, gain: float) -> TrainingFrame:
    """Repeat the simulation of a frame at a higher gain and a proportionally shorter exposure time.

    Parameters
    ----------
    frame : TrainingFrame
        The simulated frame.
    camera : CameraModel
        The camera of the frame, with its original gain.
    gain : float
        Factor by which the analog gain is multiplied and the exposure time is divided.

    Returns
    -------
    TrainingFrame
        The new frame, with all types of noise.
    """
    electrons, seconds = frame.electrons / np.float32(gain), frame.exposure / gain
    rng, values = np.random.default_rng(frame.seed), sensor.mosaic(electrons, camera.cfa)
    raw = sensor.expose(camera.at_gain(gain), values, seconds, rng)
    return replace(frame, raw=raw, electrons=electrons, exposure=seconds)


class AtGain:
    """Training-set reader that simulates each frame again, at `gain` times its analog gain."""

    def __init__(self, reader: TrainingSetReader, gain: float) -> None:
        self.head = replace(reader.head, camera=reader.head.camera.at_gain(gain))
        self._reader, self._gain = reader, gain

    def frame(self, index: int) -> TrainingFrame:
        frame = self._reader.frame(index)
        assert isinstance(frame, TrainingFrame)
        return exposed_again(frame, self._reader.head.camera, self._gain)


def frames_like(head: TrainingSet) -> Callable[[TrainingPair, LightSpectrum], Iterator[TrainingFrame]]:
    """Return a function that simulates additional frames with a training set's camera and target.

    Parameters
    ----------
    head : TrainingSet
        Header of the training set.

    Returns
    -------
    callable
        Function of a frame and an illuminant spectrum. It yields frames of dead-leaves scenes under this illuminant, with
        the luminance and the exposure time of the given frame.
    """
    camera = head.camera.resized(*DRAWN_SIZE)
    target = target_of(head)

    def drawn(like: TrainingPair, spectrum: LightSpectrum) -> Iterator[TrainingFrame]:
        from l3cli.simulation import procedural  # imported here, so that commands without scenes start faster

        light = _lit(spectrum, like.luminance)
        for number in range(DRAWN):
            wanted = WantedScene(DeadLeaves(size=DRAWN_SIZE), number=number)
            scene = procedural.draw(wanted, DRAWN_SEED, camera.wavelength, camera.polarisers is not None)
            yield simulate(camera, scene, light, like.exposure, Lens(), (DRAWN_SEED, number), target)

    return drawn


def target_of(head: TrainingSet) -> Target:
    """Return the target for additional frames of a training set.

    The target is XYZ if the outputs were defined by a file of matching functions, which a training set does not store.
    """
    kinds = {names: kind for kind, names in OUTPUTS.items()} | {head.camera.channels: CAMERA}
    light = _lit(head.target_light, 1.0) if head.target_light else None
    if head.outputs not in kinds:
        return replace(XYZ, light=light)
    return Target(head.outputs, head.target_description, kinds[head.outputs], light=light)


def _lit(spectrum: LightSpectrum, luminance: float) -> Light:
    return Light("", 1.0, spectrum.wavelength, spectrum.radiance.astype(np.float64)).at(luminance)


def _collected(
    camera: CameraModel, scene: Scene | ChannelPicture, light: Light, lens: Lens, target: Target
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float64]]:
    """Compute the mean photo-electron rates of all channels, and the target.

    Returns
    -------
    ideal : ndarray, (output, row, col)
        Target, without lens blur or noise.
    rates : ndarray, (channel, row, col)
        Photo-electron rates in e-/s.
    white : ndarray, (output)
        Target of a perfect white.
    """
    if isinstance(scene, ChannelPicture):
        return _signalled(camera, scene, light)
    bands, pitch = scene.wavelength, camera.pixel_pitch
    wanted = output_weights(target, camera, light, bands)
    collected = electron_weights(camera, light, bands)
    transfer = lens_transfer(camera.optics, pitch, bands, lens.diffraction, lens.defocus_um * 1e-6)
    terms = np.ones((1, bands.size)) if transfer is None else transfer.spectral
    # Normalised weights make the rounding to float32 independent of the luminance.
    unit = collected.max() or 1.0
    through = (collected[:, None] / unit * terms).reshape(-1, bands.size)
    if scene.polarisation is None:
        planes = project(scene.reflectance, np.concatenate([wanted, through]))
    else:
        targets = np.concatenate([wanted[None], polarised_weights(target, camera, light, bands)])
        weights = (stokes_weights(camera, light, bands)[:, :, None] / unit * terms).reshape(3, -1, bands.size)
        planes = project_stokes(scene, np.concatenate([targets, weights], axis=1))
    ideal, rates = planes[: len(wanted)], planes[len(wanted) :]
    if transfer is not None:
        shape = (len(collected), len(terms), *rates.shape[1:])
        rates = blurred_channels(rates.reshape(shape), transfer, pitch)
        np.maximum(rates, 0.0, out=rates)  # the approximate blur around a bright point can become negative
    rates *= np.float32(unit)
    if lens.off_axis:
        distance, shape = camera.optics.image_distance, (rates.shape[1], rates.shape[2])
        rates *= relative_illumination(distance, pitch, shape).astype(np.float32)
    return ideal, rates, output_weights(target, camera, light, light.wavelength).sum(axis=1)


def project_stokes(scene: Scene, weights: Array) -> NDArray[np.float32]:
    """Compute weighted sums over the Stokes parameters and bands of a scene.

    The sums are computed in float64, because large terms of opposite sign nearly cancel if a pixel's polariser is
    perpendicular to the polarisation of the light.

    Parameters
    ----------
    scene : Scene
        A scene with polarisation.
    weights : ndarray, (3, channel, band)
        Weights of S0, S1 and S2 in each channel.

    Returns
    -------
    ndarray, (channel, row, col)
        The weighted sums.
    """
    assert scene.polarisation is not None
    (rows, cols, bands), shares = scene.reflectance.shape, scene.polarisation.weights(scene.wavelength)
    total = np.empty((weights.shape[1], rows, cols), np.float32)
    for first in range(0, rows, step := max(STRIP_PIXELS // cols, 1)):
        strip = np.s_[first : first + step]
        reflectance = scene.reflectance[strip].reshape(-1, bands).T.astype(np.float64)
        ratio = scene.polarisation.ratio[strip].reshape(-1, 2, len(shares))
        exact = weights[0] @ reflectance
        for node, share in enumerate(shares):
            seen = np.flatnonzero(share)
            near = slice(seen[0], seen[-1] + 1) if seen.size else slice(0)
            for index in (0, 1):
                exact += ratio[:, index, node] * ((weights[1 + index] * share)[:, near] @ reflectance[near])
        total[:, strip] = exact.reshape(len(exact), -1, cols)
    return total


def spectral_planes(
    camera: CameraModel, scene: Scene, light: Light, lens: Lens, basis: Array
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Project a scene onto an orthogonal basis of photon spectra, with and without lens blur.

    Parameters
    ----------
    camera : CameraModel
        The camera. Its colour filters are not used.
    scene : Scene
        The scene.
    light : Light
        Illuminant of the scene.
    lens : Lens
        Diffraction and defocus of the lens.
    basis : ndarray, (wavelength, term)
        Orthogonal spectra.

    Returns
    -------
    blurred, sharp : ndarray, (term, row, col)
        Coefficients of the photon spectrum at each pixel, with and without lens blur.
    target : ndarray, (output, row, col)
        XYZ relative to white, without lens blur.
    """
    bands, pitch = scene.wavelength, camera.pixel_pitch
    wanted = output_weights(XYZ, camera, light, bands)
    wanted = wanted / output_weights(XYZ, camera, light, light.wavelength).sum(axis=1, keepdims=True)
    coefficients = basis.T @ photon_weights(camera, light, bands) / np.square(basis).sum(axis=0)[:, None]
    transfer = lens_transfer(camera.optics, pitch, bands, lens.diffraction, lens.defocus_um * 1e-6)
    terms = np.zeros((0, bands.size)) if transfer is None else transfer.spectral
    through = (coefficients[:, None] * terms).reshape(-1, bands.size)
    planes = project(scene.reflectance, np.concatenate([wanted, coefficients, through]))
    target, sharp, parts = np.split(planes, [len(wanted), len(wanted) + len(coefficients)])
    if transfer is None:
        return sharp, sharp, target
    return blurred_channels(parts.reshape(len(coefficients), len(terms), *parts.shape[1:]), transfer, pitch), sharp, target


def _signalled(
    camera: CameraModel, picture: ChannelPicture, light: Light
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float64]]:
    """Do the same as `_collected` for a picture of channel signals. The target is the camera's bands."""
    full = (white_rates(camera, light) * camera.channel_gains).max()
    white = full * camera.saturation_exposure / camera.full_scale
    signal = np.moveaxis(picture.signal, -1, 0)
    rates, ideal = (np.ascontiguousarray(signal * np.float32(unit)) for unit in (full, white))
    if camera.readout is not None:
        rates *= (camera.sensitivity / camera.channel_gains).astype(np.float32)[:, None, None]
    return ideal, rates, np.full(len(signal), white)


def make_pair(
    raw: RawFrame, picture: NDArray[np.float32], outputs: tuple[str, ...], camera: CameraModel, pair: Pair, name: str
) -> TrainingPair:
    """Combine a raw frame and a picture of the same scene, which becomes the target, into a training pair.

    Raw frame and picture are cropped to begin at CFA site (0, 0).

    Parameters
    ----------
    raw : RawFrame
        The raw frame.
    picture : ndarray, (row, col, output)
        Linear picture in upright orientation.
    outputs : tuple of str
        Names of the outputs.
    camera : CameraModel
        The camera.
    pair : Pair
        Offset and scale from the recipe. The scale is the raw signal of a surface, as a fraction of full scale, divided by
        its value in the picture. By default, the scale is fitted under the assumption that the scene is grey on average.
    name : str
        Name of the pair.

    Raises
    ------
    ValueError
        If the picture extends beyond the raw frame, or if raw values exceed the bit depth of the camera.
    """
    picture = as_taken(picture, raw.orientation)
    own_levels = (raw.black_level, raw.white_level) == (camera.black_level, camera.white_level)
    if own_levels and raw.values.max() >= 2**camera.bits:
        raise ValueError(
            f"the raw frame contains {raw.values.max()} DN, which does not fit into {camera.bits} bits; correct sensor.bits "
            "in the camera recipe"
        )
    levelled = raw.at_levels(camera.black_level, camera.white_level, camera.bits).values
    rows, cols = picture.shape[:2]
    top, left = pair.offset
    if top + rows > levelled.shape[0] or left + cols > levelled.shape[1]:
        raise ValueError(
            f"the picture with {rows}×{cols} pixels at offset {top}, {left} extends beyond the raw frame with "
            f"{levelled.shape[0]}×{levelled.shape[1]} pixels; crop the picture to the area of the raw frame"
        )
    down, across = (
        -(phase + start) % period for phase, start, period in zip(raw.phase, pair.offset, camera.cfa.shape, strict=True)
    )
    if down >= rows or across >= cols:
        raise ValueError("the picture is smaller than one period of the CFA; use a larger picture")
    values = levelled[top + down : top + rows, left + across : left + cols]
    wanted = np.moveaxis(picture[down:, across:], 2, 0)
    scale = pair.scale / raw.light_share if pair.scale else _grey_world_scale(values, wanted, camera)
    white = spectra.white_point("D65") if outputs == ("X", "Y", "Z") else np.ones(len(outputs))
    unit = scale * camera.saturation_exposure  # cd/m² per picture value, for an exposure time of 1 s
    return TrainingPair(
        raw=np.ascontiguousarray(values),
        target=np.ascontiguousarray(wanted * np.float32(unit)),
        white=white * unit,
        scene=name,
        illuminant=PAIR_LIGHT,
        luminance=unit,
        exposure=1.0,
    )


def _grey_world_scale(values: NDArray[np.uint16], picture: NDArray[np.float32], camera: CameraModel) -> float:
    """Fit the scale of a pair under the assumption that the scene is grey on average, under D65.

    Raises ValueError if all pixels are black or nearly white.
    """
    share = (values - camera.black_level) / (camera.white_level - camera.black_level)
    bright = picture[1] if len(picture) == 3 else picture.mean(axis=0)
    usable = (share < BRIGHT) & (bright < BRIGHT)
    if not usable.any() or bright[usable].mean() <= 0:
        raise ValueError(
            "the scale cannot be fitted, because all pixels of the picture are black or nearly white; use another picture, "
            "or set scale"
        )
    rates = white_rates(camera, make_light("D65", {}, camera.wavelength))
    response = (rates / rates.max())[camera.cfa].mean()
    return float(max(share[usable].mean(), 1e-6) / response / bright[usable].mean())


@dataclass(frozen=True)
class LowRankTransfer:
    """Optical transfer functions at all wavelengths, approximated by a sum of few separable terms.

    Each term is the product of a function of spatial frequency (radial) and a function of wavelength (spectral).
    """

    frequency: Array  # (sample,), cycles/m
    radial: Array  # (term, sample), radial factors at `frequency`
    spectral: Array  # (term, wavelength), spectral factors


@functools.lru_cache(maxsize=4)
def low_rank_transfer(highest: float, wavelength: tuple[float, ...], f_number: float) -> LowRankTransfer:
    """Approximate the diffraction MTF by as few separable terms as possible, with a singular value decomposition.

    Parameters
    ----------
    highest : float
        Highest spatial frequency in cycles/m.
    wavelength : tuple of float
        Wavelengths in nm.
    f_number : float
        F-number of the lens.

    Returns
    -------
    LowRankTransfer
        The approximation, with an error of at most LOW_RANK_ERROR at all sampled frequencies and wavelengths.
    """
    frequency = np.linspace(0.0, highest, RADIAL_SAMPLES)
    exact = diffraction_transfer(frequency, np.array(wavelength), f_number)
    left, strength, right = np.linalg.svd(exact, full_matrices=False)
    terms = 1
    while abs((left[:, :terms] * strength[:terms]) @ right[:terms] - exact).max() > LOW_RANK_ERROR:
        terms += 1
    return LowRankTransfer(frequency, (left[:, :terms] * strength[:terms]).T, right[:terms])


def lens_transfer(
    optics: Optics, pixel_pitch: float, wavelength: Array, diffraction: bool, defocus: float
) -> LowRankTransfer | None:
    """Compute the transfer function of the lens at each wavelength, from diffraction and defocus.

    Parameters
    ----------
    optics : Optics
        The lens.
    pixel_pitch : float
        Pixel pitch in m.
    wavelength : ndarray, (wavelength)
        Wavelengths in nm.
    diffraction : bool
        Whether to include diffraction.
    defocus : float
        Standard deviation of a Gaussian blur on the sensor, in m.

    Returns
    -------
    LowRankTransfer or None
        None if the lens does not blur.
    """
    highest = float(np.sqrt(0.5) / pixel_pitch)
    if diffraction:
        transfer = low_rank_transfer(highest, tuple(wavelength), optics.f_number)
    elif defocus > 0:
        frequency = np.linspace(0.0, highest, RADIAL_SAMPLES)
        transfer = LowRankTransfer(frequency, np.ones((1, RADIAL_SAMPLES)), np.ones((1, wavelength.size)))
    else:
        return None
    gaussian = gaussian_transfer(transfer.frequency, defocus)
    return LowRankTransfer(transfer.frequency, transfer.radial * gaussian, transfer.spectral)


def blurred_channels(planes: NDArray[np.float32], transfer: LowRankTransfer, pixel_pitch: float) -> NDArray[np.float32]:
    """Apply the lens blur to the channel signals. `planes` is overwritten.

    Parameters
    ----------
    planes : ndarray, (channel, term, row, col)
        Channel signals, computed with the spectral factor of each term of the transfer function.
    transfer : LowRankTransfer
        Transfer function of the lens.
    pixel_pitch : float
        Pixel pitch in m.

    Returns
    -------
    ndarray, (channel, row, col)
        Blurred signals: the planes, filtered with the radial factors and summed over the terms.

    Notes
    -----
    The filters are applied in the discrete cosine transform domain, so frames are mirrored at their borders.
    """
    from scipy import fft

    rows, cols = planes.shape[2:]
    frequency = np.hypot(np.arange(rows)[:, None] / (2 * rows), np.arange(cols) / (2 * cols)) / pixel_pitch
    maps = [np.interp(frequency, transfer.frequency, radial).astype(np.float32) for radial in transfer.radial]
    blurred = np.empty((len(planes), rows, cols), np.float32)
    for channel, terms in enumerate(planes):
        total = fft.dctn(terms[0], overwrite_x=True) * maps[0]
        for plane, factor in zip(terms[1:], maps[1:], strict=True):
            total += fft.dctn(plane, overwrite_x=True) * factor
        blurred[channel] = fft.idctn(total, overwrite_x=True)
    return blurred


def project(cube: NDArray[np.float32], weights: Array) -> NDArray[np.float32]:
    """Compute weighted sums over the bands of a cube, in float32.

    Parameters
    ----------
    cube : ndarray, (row, col, band)
        Values of each band.
    weights : ndarray, (channel, band)
        Weight of each band in each channel.

    Returns
    -------
    ndarray, (channel, row, col)
        Weighted sums over the bands.
    """
    rows, cols, bands = cube.shape
    return (weights.astype(np.float32) @ cube.reshape(-1, bands).T).reshape(-1, rows, cols)


@dataclass(frozen=True)
class SimulationRun:
    """Validated settings that all frames of a simulation share: recipe, camera, target and illuminants."""

    recipe: SceneRecipe
    camera: CameraModel
    target: Target
    lights: Mapping[str, Light]  # illuminants of the simulation, at 1 cd/m²
    recorded: Mapping[str, Light]  # illuminants under which scene files were recorded
    seed: int
    base: Path  # folder of the recipe

    @property
    def frame_bytes(self) -> int:
        """Size of the largest frame in bytes, including the electrons of all channels, the mosaic and the target."""
        return self.camera.rows * self.camera.cols * (4 * len(self.camera.channels) + 2 + 4 * len(self.target.outputs))

    def frame(self, scene: Scene | ChannelPicture, shot: Shot, seconds: float | None = None) -> TrainingFrame:
        """Simulate a frame.

        Parameters
        ----------
        scene : Scene or ChannelPicture
            The scene.
        shot : Shot
            Illuminant and exposure of the frame.
        seconds : float, optional
            Exposure time in s. [default: as in the recipe]

        Raises
        ------
        InputFileError
            If the exposure is automatic and the camera collects no electrons.
        """
        light = self._light(scene, shot)
        exposure = self._exposure(light, shot) if seconds is None else seconds
        noise, seed = self.recipe.sensor.noise_model or self.recipe.sensor.noise, (self.seed, shot.index)
        with raised_as(InputFileError, f"scene {scene.name}"):
            return simulate(self.camera, scene, light, exposure, self.recipe.lens, seed, self.target, noise)

    def exposure_time(self, scene: Scene | ChannelPicture, shot: Shot) -> float:
        """Return the exposure time in s that the recipe specifies for a frame.

        Raises
        ------
        InputFileError
            If the exposure is automatic and the camera collects no electrons.
        """
        light = self._light(scene, shot)
        exposure = self._exposure(light, shot)
        if isinstance(exposure, float):
            return exposure
        rates = _collected(self.camera, scene, light, self.recipe.lens, XYZ)[1]
        with raised_as(InputFileError, f"scene {scene.name}"):
            return exposure(self.camera, sensor.mosaic(rates, self.camera.cfa))

    def _light(self, scene: Scene | ChannelPicture, shot: Shot) -> Light:
        if shot.illuminant == SCENE_LIGHT:
            assert isinstance(scene, Scene)
            return scene_light(scene, shot.luminance)
        return self.lights[shot.illuminant].at(shot.luminance)

    def _exposure(self, light: Light, shot: Shot) -> float | Automatic:
        """Return the exposure time in s, or a function that computes it from a mosaic if the exposure is automatic."""
        control, _ = self.recipe.exposures()
        if control == "share":
            return automatic_exposure(self.camera, light, shot.exposure)
        if control == "saturated":
            return partial(saturating_exposure, share=shot.exposure)
        return partial(averaging_exposure, share=shot.exposure) if control == "mean" else shot.exposure
