"""Compares a table with baselines frame by frame, and collects all metrics in a JSON document.

The document includes mean errors by class, to find the classes with the largest errors.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingFrame, TrainingPair, TrainingSet
from l3cli.classes import chroma, contrast, level, saturation
from l3cli.classes.features import features_of
from l3cli.classes.names import EVERY_FEATURE
from l3cli.errors import InputFileError, RecipeError
from l3cli.evaluation.basic import Colour, develop, develop_bands, develop_stokes, fit_colour, light_of, merges
from l3cli.evaluation.demosaic import band_baselines, baselines, interpolate, stokes_baselines
from l3cli.evaluation.quality import (
    PATCH_KINDS,
    VIEWING,
    Target,
    band_figures,
    cropped,
    judge_bands,
    judge_single,
    judge_stokes,
    mottle,
)
from l3cli.evaluation.reflectance import ESTIMATES, Drawn, Estimates, judge_reflectances
from l3cli.frames.frame import RawFrame
from l3cli.physics import spectra
from l3cli.physics.display import XYZ
from l3cli.physics.figures import known_mean, sign
from l3cli.physics.spectra import RADIANCES, REFLECTANCES
from l3cli.physics.stokes import STOKES, has_stokes

Array = NDArray[np.floating]
MIN_PIXEL_FRACTION = 1e-3  # classes with a smaller fraction of all pixels are not listed as worst classes
LISTED_CLASSES = 10  # number of worst classes in the document


class ClassErrors:
    """Sums the errors of each pipeline over the pixels of each class. Classes of all CFA sites are counted together.

    A class is a combination of level, contrast, kind (chroma or saturation case) and optional features such as direction.
    """

    def __init__(self, table: TransformTable, pipelines: tuple[str, ...]) -> None:
        self._rule, self._table = table.first.rule, table
        self._pixels = np.zeros(table.first.rule.shape, dtype=np.int64)
        self._sums = {name: np.zeros(table.first.rule.shape) for name in pipelines}

    def add(self, labels: NDArray[np.integer], errors: dict[str, Array]) -> None:
        """Add the errors of all pixels of a frame to the sums of their classes.

        Parameters
        ----------
        labels : ndarray, (…)
            Class in the first layer, for each pixel.
        errors : dict of str to ndarray, (…)
            Name of each pipeline, and its error at each pixel.
        """
        rule = self._rule
        within, classes = rule.within_site(labels.ravel()), rule.classes_per_site
        self._pixels += rule.by_feature(np.bincount(within, minlength=classes))[0]
        for name, error in errors.items():
            self._sums[name] += rule.by_feature(np.bincount(within, weights=error.ravel(), minlength=classes))[0]

    def by_feature(self, figure: str) -> dict[str, list[dict[str, Any]]]:
        """Return each pipeline's mean error for each value of each class feature.

        Parameters
        ----------
        figure : str
            Key of the mean error in the result.

        Returns
        -------
        dict of str to list of dict
            Feature → one entry per value that occurs, with a description of the value, the number of pixels, and the mean
            error of each pipeline.
        """
        table, rule = self._table, self._rule
        entries_of: dict[str, list[tuple[dict[str, Any], Any]]] = {
            "level": [(level.entry(table, index), np.s_[index]) for index in range(rule.levels)],
            "contrast": [(contrast.entry(table, index), np.s_[:, index]) for index in range(rule.contrasts)],
            "chroma": [(chroma.entry(table, index), np.s_[..., index]) for index in range(rule.chromas)],
            "saturation": [
                (saturation.entry(table, index), np.s_[..., rule.kinds_of(index)]) for index in range(rule.cases)
            ],
        }
        values = rule.split_features(np.arange(rule.combinations))
        for (module, feature), value in zip(features_of(rule), values, strict=True):
            entries_of[feature.name] = [
                (module.entry(table, index), np.s_[:, :, value == index]) for index in range(feature.size)
            ]
        every = {name: [self._entry(figure, *about) for about in entries] for name, entries in entries_of.items()}
        return {name: [entry for entry in entries if entry["pixels"]] for name, entries in every.items()}

    def worst(self, figure: str, pipeline: str) -> list[dict[str, Any]]:
        """Return up to LISTED_CLASSES classes with the largest mean errors of a pipeline, the worst first.

        Classes with less than MIN_PIXEL_FRACTION of all pixels are omitted. `figure` is the key of the mean error in the
        entries.
        """
        pixels = np.maximum(self._pixels, 1)
        seen = self._pixels >= max(MIN_PIXEL_FRACTION * self._pixels.sum(), 1)
        mean = np.where(seen, self._sums[pipeline] / pixels, -1.0)
        entries = []
        for flat in np.argsort(mean, axis=None, kind="stable")[::-1][: min(LISTED_CLASSES, int(seen.sum()))]:
            place = self._rule.split(int(flat))
            case = int(self._rule.case(place.kind))
            about = level.entry(self._table, place.level) | contrast.entry(self._table, place.contrast)
            about |= {"chroma": None if case else place.kind, "case": case}
            values = self._rule.split_features(place.combination)
            for (module, _), value in zip(features_of(self._rule), values, strict=True):
                about |= module.entry(self._table, value)
            entries.append(self._entry(figure, about, place[1:]))
        return entries

    def _entry(self, figure: str, about: dict[str, Any], where: Any) -> dict[str, Any]:
        pixels = int(self._pixels[where].sum())
        means = {name: {figure: float(sums[where].sum()) / max(pixels, 1)} for name, sums in self._sums.items()}
        return {**about, "pixels": pixels, **means}


FORMAT = 3  # version of the document, which increases when keys change
OURS = "ours"  # pipeline name of the table
RESERVED_NAMES = {
    "scene", "illuminant", "luminance", "frames", "pixels", "from", "to", "band", "case", "varies", "ideal", "error",
    *EVERY_FEATURE,
}  # fmt: skip # names of keys and picture files, which no pipeline may have
MAX_OUTPUT_CD_PER_M2 = 1e24  # cd/m²; larger outputs are rejected, so that sums of squares remain finite


class Evaluation:
    """Evaluates a table, untrained baselines and pictures from other programs (rivals) on the frames of a training set.

    Frames are added one by one, without keeping their pictures in memory.

    Parameters
    ----------
    table : TransformTable
        Table to evaluate.
    head : TrainingSet
        Camera, outputs and target illuminant of the frames.
    viewing : float
        Picture samples per degree of visual angle, for S-CIELAB.
    border : int, optional
        Margin of each frame that is not evaluated, in pixels. [default: the patch radius, so that the patches of all
        evaluated pixels are inside the frame]
    rivals : sequence of str
        Names of other pipelines, whose pictures are passed to `planes`.
    drawn : callable, optional
        Simulates training frames for the spectral estimators. [default: no spectral estimators]

    Raises
    ------
    InputFileError
        If the table and the frames have different CFAs or outputs.
    RecipeError
        If there are rivals but the outputs are not XYZ, or if a rival's name is reserved or not unique.
    """

    def __init__(
        self,
        table: TransformTable,
        head: TrainingSet,
        viewing: float = VIEWING,
        border: int | None = None,
        rivals: Sequence[str] = (),
        drawn: Drawn | None = None,
    ) -> None:
        camera = head.camera
        require_cfa(table, camera)
        if head.outputs != table.outputs:
            names = f"table: {', '.join(table.outputs)}; training set: {', '.join(head.outputs)}"
            raise InputFileError(
                f"the table and the training set have different outputs ({names}); use a training set with the table's "
                "outputs"
            )
        self._table, self._camera, self._wanted, self._viewing = table, camera, head.target_light, viewing
        self._pictures = table.outputs == XYZ
        self._border = table.first.rule.radius if border is None else border
        self._merges = merges(camera)
        if self._pictures:
            self._baselines = dict.fromkeys(self._merges, interpolate) | baselines(camera.cfa)
        else:
            self._baselines = band_baselines(camera.cfa) if table.outputs == camera.channels else {}
            if table.outputs == STOKES and camera.polarisers is not None:
                self._baselines = stokes_baselines(camera.cfa)
        self._estimates = None
        if drawn is not None and table.outputs in (REFLECTANCES, RADIANCES):
            self._estimates = Estimates(camera, drawn)
        if rivals and not self._pictures:
            raise RecipeError(
                "‹rival› requires a table with the outputs X, Y, Z, but this table has the outputs "
                f"{', '.join(table.outputs)}; remove ‹rival›"
            )
        self._rivals = tuple(rivals)
        for name in self.pipelines:
            if self.pipelines.count(name) > 1 or name in RESERVED_NAMES:
                raise RecipeError(f'the pipeline name "{name}" is reserved or not unique; choose a different name')
        single = "mean_error" if len(table.outputs) == 1 else "mean_angle"
        single = "mean_dolp_error" if has_stokes(table.outputs) else single
        self._figure = "mean_delta_e" if self._pictures else single
        self._colours: dict[bytes, Colour] = {}  # illuminant → white balance and colour matrix
        self._frames: list[dict[str, Any]] = []
        # For each frame: the range of its level, the type of each uniform patch, and each pipeline's colour variances.
        self._patches: list[tuple[tuple[float, float], list[str], dict[str, Array]]] = []
        self._bands: list[dict[str, list[dict[str, float]]]] = []  # for each frame: pipeline → metrics of each output
        self._classes = ClassErrors(table, self.pipelines)

    @property
    def pipelines(self) -> tuple[str, ...]:
        """Names of the compared pipelines: "ours" (the table), the baselines, the spectral estimators, and the rivals.

        Baselines exist if the outputs are XYZ, the camera's bands or Stokes parameters.
        """
        return (OURS, *self._baselines, *(ESTIMATES if self._estimates else ()), *self._rivals)

    def planes(self, frame: TrainingPair, outputs: Array, rivals: Mapping[str, Array] | None = None) -> dict[str, Array]:
        """Return the outputs of all compared pipelines for a frame: the table, baselines, spectral estimators and rivals.

        Parameters
        ----------
        frame : TrainingPair
            Raw frame with its target.
        outputs : ndarray, (output, row, col)
            The frame as rendered with the table, in output units.
        rivals : mapping of str to ndarray, (3, row, col), optional
            Name of each rival, and its picture in XYZ, in the unit of the target.

        Returns
        -------
        dict of str to ndarray, (output, row, col)
            Name of each pipeline, and its outputs in the unit of the target.

        Raises
        ------
        InputFileError
            If the frame is too small for the border, if its white has a luminance of 0, or if `outputs` are not finite.
        """
        border = self._border
        if min(frame.raw.shape) <= 2 * border:
            size = "×".join(map(str, frame.raw.shape))
            raise InputFileError(
                f"frame {frame.scene} ({size} pixels) is too small for a border of {border} pixels; use larger frames"
            )
        estimated = self._estimates.planes(frame) if self._estimates else {}
        shown = {name: self._as_shown(of, frame) for name, of in (rivals or {}).items()}
        return self.developed(frame, outputs) | estimated | shown

    def developed(self, frame: TrainingPair, outputs: Array) -> dict[str, Array]:
        """Return the outputs of the table and the baselines for a frame of any size.

        Parameters and result are as in `planes`, without spectral estimators and rivals.

        Raises
        ------
        InputFileError
            If the frame's white has a luminance of 0, or if `outputs` are not finite.
        """
        if self._pictures and not frame.white[1] > 0:
            raise InputFileError(f"the white of frame {frame.scene} has a luminance of 0; simulate the training set again")
        with np.errstate(over="ignore"):
            ours = outputs * (self._table.output_unit / frame.exposure)
        if not np.abs(ours).max() <= MAX_OUTPUT_CD_PER_M2:
            raise InputFileError(
                f"the table produces infinite or implausibly large values for frame {frame.scene}; train the table again"
            )
        planes: dict[str, Array] = {OURS: ours}
        for name, demosaic in self._baselines.items():
            if self._pictures:
                planes[name] = develop(frame, self._camera, self._colour(frame), demosaic, self._merges.get(name))
            elif self._table.outputs == STOKES:
                planes[name] = develop_stokes(frame, self._camera, demosaic)
            else:
                planes[name] = develop_bands(frame, self._camera, self._wanted is not None, demosaic)
        return {name: self._as_shown(of, frame) for name, of in planes.items()}

    def wanted(self, frame: TrainingPair) -> TrainingPair:
        """Return a frame with the target that all pipelines are compared with.

        If the table renders grey pictures, the target becomes a grey of the same luminance, because a camera with one
        channel cannot distinguish colours.
        """
        return dataclasses.replace(frame, target=self._as_shown(frame.target, frame))

    def _as_shown(self, planes: Array, frame: TrainingPair) -> Array:
        """Replace XYZ planes (3, row, col) by greys of the same luminance, if the table renders grey pictures."""
        if not (self._pictures and self._table.shows_grey and frame.white[1] > 0):
            return planes
        return np.asarray(planes[1] * (frame.white / frame.white[1])[:, None, None], planes.dtype)

    def add(self, frame: TrainingPair, planes: dict[str, Array], labels: NDArray[np.integer]) -> None:
        """Add a frame to the evaluation.

        Parameters
        ----------
        frame : TrainingPair
            Frame from `wanted`.
        planes : dict of str to ndarray, (output, row, col)
            Result of `planes`.
        labels : ndarray of int, (row, col)
            Class of each pixel in the table's first layer.
        """
        border = self._border
        black_level = self._camera.black_level + self._camera.dark_signal(frame.dark_time)
        level = float(frame.raw.mean() - black_level) / (self._camera.white_level - self._camera.black_level)
        about = {
            "scene": frame.scene, "illuminant": frame.illuminant, "luminance": frame.luminance, "level": level,
            "exposure": frame.exposure, "clipped": float((frame.raw >= self._camera.white_level).mean()),
            "shown": frame.shown and {"scene": frame.shown.scene.tolist(), "light": frame.shown.light},
        }  # fmt: skip
        judged: dict[str, tuple[Any, Array]] = {}
        counted = _counted(frame, border)
        if self._pictures:
            target, variances = Target(frame.target, frame.white, border, self._viewing, counted), {}
            for name, of in planes.items():
                figures, errors, variances[name] = target.judge(of)
                judged[name] = figures, errors
            self._patches.append((_octave(level), target.patches.kinds, variances))
        else:
            several = judge_reflectances if self._table.outputs == REFLECTANCES else judge_bands
            judge: Callable[..., tuple[Any, Array]] = judge_single if len(self._table.outputs) == 1 else several
            if has_stokes(self._table.outputs):
                judge = functools.partial(judge_stokes, outputs=self._table.outputs)
            wanted: dict[str, Any] = {"target": frame.target, "white": frame.white, "border": border, "counted": counted}
            judged = {name: judge(of, **wanted) for name, of in planes.items()}
        self._frames.append({**about, **{name: dataclasses.asdict(figures) for name, (figures, _) in judged.items()}})
        if not (self._pictures or has_stokes(self._table.outputs)):
            self._bands.append({name: band_figures(of, **wanted) for name, of in planes.items()})
        known = np.isfinite(judged[OURS][1])  # the same for all pipelines, because it depends only on the target
        self._classes.add(cropped(labels, border)[known], {name: errors[known] for name, (_, errors) in judged.items()})

    def document(self, by_gain: Sequence[dict[str, Any]] = ()) -> dict[str, Any]:
        """Return all metrics as a dictionary with the keys of `l3 evaluate --json`.

        Parameters
        ----------
        by_gain : sequence of dict
            Mean metrics of each pipeline at each analog gain, for the key by_gain.

        Returns
        -------
        dict
            The metrics of each pipeline are listed under its name. The keys are:

            * format: version of the document, 3. It increases when keys change.
            * camera and outputs: name of the camera, and names of the outputs.
            * viewing: picture samples per degree of visual angle for S-CIELAB.
            * border: width of the margin that is not evaluated, in pixels.
            * pipelines: names of the pipelines. "ours" is first, and rivals are last.
            * frames: list of frames. Each frame has the keys

              * scene and illuminant: names of the scene and the illuminant.
              * luminance: luminance of the scene's white, in cd/m².
              * level: mean raw signal after subtraction of the dark signal, as a fraction of full scale.
              * exposure: exposure time in s.
              * clipped: fraction of the pixels at full scale.
              * shown: fingerprints of the scene and of the illuminant that were simulated, or null.
              * the name of each pipeline: its metrics. They are the attributes of Quality for XYZ, ReflectanceQuality for
                reflectances, StokesQuality for Stokes parameters, SingleQuality for a single output, and BandQuality for
                all other outputs.
            * mean: mean of every metric over the frames.
            * better: for each metric and each pipeline except the table, the number of frames in which the table is better.
            * by_level: mean metrics and number of frames, for each range (from, to) of frame levels. A range spans a factor
              of two.
            * by_illuminant: mean metrics and number of frames, for each illuminant.
            * by_gain: mean metrics of a few simulated frames, for each analog gain relative to the camera model. The list
              is empty unless the table has transforms for several gains.
            * by_patch: mottle and number of uniform patches, for each type of patch and each range (from, to) of frame
              levels.
            * by_band: mean psnr, output_psnr and ssim of each output. The list is empty if the outputs are XYZ or contain
              Stokes parameters.
            * by_class: mean error and number of pixels, for each value of each class feature. Pixels without a spectral
              angle are not counted.
            * worst_classes: the classes with the table's largest mean errors, with level, from, to, contrast, chroma (null
              if saturated), case and the number of pixels.

            The caller adds the key standards (see `standards.edge_document` and `standards.grey_document`), with the keys:

            * edge: for edges across rows and across columns, the frequencies in cycles/pixel, and mtf and mtf50 of the
              ideal lens and pixel and of each pipeline.
            * grey: SNR of a grey target at each illuminance (in closed form, in raw frames and for each pipeline), and the
              illuminance at which the SNR is 10. Null if the responsivities are not absolute.
            * chart: mean ΔE00 of each pipeline over random cameras. Null if the responsivities have no confidence band.
            * figures: mtf50_rows, mtf50_columns, snr10 and camera_delta_e of each pipeline.
        """
        first = self._frames[0]
        return {
            "format": FORMAT,
            "camera": self._camera.name,
            "outputs": list(self._table.outputs),
            "viewing": self._viewing,
            "border": self._border,
            "pipelines": list(self.pipelines),
            "frames": self._frames,
            "mean": self._mean(self._frames),
            "better": {name: self._better(name, tuple(first[OURS])) for name in self.pipelines[1:]},
            "by_level": self._grouped(lambda frame: _octave(frame["level"]), lambda key: {"from": key[0], "to": key[1]}),
            "by_illuminant": self._grouped(lambda frame: frame["illuminant"], lambda key: {"illuminant": key}),
            "by_gain": list(by_gain),
            "by_patch": self._by_patch(),
            "by_band": self._by_band(),
            "by_class": self._classes.by_feature(self._figure),
            "worst_classes": self._classes.worst(self._figure, OURS),
        }

    def _colour(self, frame: TrainingPair) -> Colour:
        light = light_of(frame, self._camera)
        key = light.wavelength.tobytes() + light.radiance.tobytes()
        if key not in self._colours:
            self._colours[key] = fit_colour(self._camera, light, self._wanted)
        return self._colours[key]

    def _mean(self, frames: Iterable[dict[str, Any]]) -> dict[str, dict[str, float | None]]:
        frames = list(frames)
        return {
            name: {figure: known_mean([frame[name][figure] for frame in frames]) for figure in frames[0][name]}
            for name in self.pipelines
        }

    def _by_patch(self) -> list[dict[str, Any]]:
        """Return the mottle of each pipeline for each type of uniform patch and each range of the frames' mean level."""
        entries = []
        for bounds, kind in itertools.product(sorted({each for each, _, _ in self._patches}), PATCH_KINDS):
            members = [
                (variances, index)
                for between, kinds, variances in self._patches
                for index, of in enumerate(kinds)
                if (between, of) == (bounds, kind)
            ]
            if members:
                about = {"from": bounds[0], "to": bounds[1], "kind": kind, "patches": len(members)}
                figures = {name: np.array([of[name][index] for of, index in members]) for name in self.pipelines}
                entries.append({**about, **{name: {"mottle": mottle(of)} for name, of in figures.items()}})
        return entries

    def _by_band(self) -> list[dict[str, Any]]:
        """Return each pipeline's mean metrics, by output."""
        bands = []
        for index, band in enumerate(self._table.outputs if self._bands else ()):
            of_band = [{name: bands[index] for name, bands in frame.items()} for frame in self._bands]
            bands.append({"band": band, **self._mean(of_band)})
        return bands

    def _better(self, baseline: str, figures: tuple[str, ...]) -> dict[str, int]:
        """Count the frames in which the table is better than `baseline`, for each metric that is known in all frames."""
        values = {of: [(frame[OURS][of], frame[baseline][of]) for frame in self._frames] for of in figures}
        whole = {figure: pairs for figure, pairs in values.items() if (None, None) not in pairs}
        return {figure: sum(sign(figure) * (a - b) > 0 for a, b in pairs) for figure, pairs in whole.items()}

    def _grouped(self, key: Callable[[dict], Any], about: Callable[[Any], dict[str, Any]]) -> list[dict[str, Any]]:
        groups = []
        for value in sorted({key(frame) for frame in self._frames}):
            members = [frame for frame in self._frames if key(frame) == value]
            groups.append({**about(value), "frames": len(members), **self._mean(members)})
        return groups


def _counted(frame: TrainingPair, border: int) -> NDArray[np.bool_] | None:
    """Return a mask (row, col) of the pixels for which the scene contains data. None means all pixels.

    Raises InputFileError if there are no data inside the border.
    """
    if not isinstance(frame, TrainingFrame) or frame.ignored is None:
        return None
    counted = frame.ignored.mask == 0
    if not cropped(counted, border).any():
        raise InputFileError(
            f"scene {frame.scene} contains no data inside the border of {border} pixels; remove this scene from the recipe"
        )
    return np.asarray(counted)


def _octave(level: float) -> tuple[float, float]:
    """Return the lower and the upper bound of the octave that contains a signal level.

    The octaves are centred on powers of two. All levels below 2^-12 belong to the octave around 2^-12.
    """
    power = np.rint(np.log2(max(level, 2.0**-12)))
    return float(2.0 ** (power - 0.5)), float(2.0 ** (power + 0.5))


def require_cfa(table: TransformTable, camera: CameraModel) -> None:
    """Raise InputFileError unless a camera has the same channels and CFA as a table."""
    if camera.channels != table.channels or not np.array_equal(camera.cfa, table.cfa):
        raise InputFileError("the training set and the table have different CFAs; use a training set for the table's camera")


def raw_of(frame: TrainingPair, index: int, camera: CameraModel) -> RawFrame:
    """Convert a training frame to a raw frame, with the dark signal that rendering subtracts.

    `index` is the frame number for the error message. Raises InputFileError if raw values or levels are invalid.
    """
    try:
        return RawFrame(
            frame.scene, frame.raw, camera.black_level, camera.white_level, dark=camera.dark_signal(frame.dark_time)
        )
    except ValueError as error:
        raise InputFileError(f"frame {index} of the training set: {error}; simulate the training set again") from error


def white_of(frame: TrainingPair) -> NDArray[np.floating]:
    """Return the XYZ of a perfect white under a frame's illuminant, or the target's white if its spectrum is unknown."""
    if frame.light is None:
        return frame.white[:3]
    return spectra.xyz_weights(frame.light.wavelength) @ frame.light.radiance
