"""The white of a frame from the frame alone: grey edges and the white patch, kept near daylight and black bodies
(docs/method.md#scene-white)."""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.frames.frame import RawFrame
from l3cli.physics import correlated_lights, spectra
from l3cli.physics.spaces import BRADFORD
from l3cli.rendering.exposure import SpreadSamples
from l3cli.rendering.white.scene_white import GREY_LEVEL, SceneWhite, Whites

Array = NDArray[np.floating]
EDGE_NORM = 6  # of Minkowski, over the edges: the strongest count most
PATCH_PERCENTILE = 99  # of each cone response: what counts as the white patch
FEWEST = 24  # samples that are neither clipped nor black, below which nothing can be said
MIREDS = np.arange(80.0, 521.0, 20.0)  # 12 500 K to 1920 K
GREENS = np.linspace(-0.2, 0.4, 7)  # as correlated_lights.GREENS
FINE = (111, 31)  # places along MIREDS and GREENS among which a white is looked for
LIKELY_ERROR, LIKELY_GREEN = 0.1, 0.1  # of the logarithm of a cone response; of a light's green


class AutoWhite:
    """Estimates whites of frames on some 1500 pixels of one CFA site rendered on the processor, as LightMeter does: a pure
    function of the frame, whatever the device. `balanced_by`: whose balances they have, None: those of the same table."""

    about, held = "estimated on the frame", False

    def __init__(self, whites: Whites, balanced_by: Whites | None = None) -> None:
        self._whites, self._table, self._balances = whites, whites.table, balanced_by or whites
        self._spread = SpreadSamples(self._table)
        self._neutrals = _neutrals(self._table)  # (mired, green, channel)
        self._places = self._log_ratios()  # (fine mired, fine green, 2)
        self._made: dict[tuple[int, int], SceneWhite] = {}

    def white(self, frame: RawFrame) -> SceneWhite | None:
        """White of a frame; None where all is clipped or dark."""
        estimate = estimated(*self._samples(frame))
        if estimate is None:
            return None
        place = self._nearest(estimate)
        if place not in self._made:
            neutral, whites = self._neutral(*place), self._balances
            self._made[place] = whites.of_neutral(neutral) if self._table.camera else whites.of_xyz(neutral)
        return self._made[place]

    def _nearest(self, estimate: Array) -> tuple[int, int]:
        """Place of the likeliest light for an estimate."""
        green = np.linspace(GREENS[0], GREENS[-1], FINE[1])
        error = ((self._places - estimate) ** 2).sum(axis=-1) / LIKELY_ERROR**2 + (green / LIKELY_GREEN) ** 2
        row, col = np.unravel_index(int(error.argmin()), error.shape)
        return int(row), int(col)

    def _neutral(self, row: int, col: int) -> Array:
        """Signals (channel) of a grey under the light of a place."""
        places = (
            np.array([place * (count - 1) / (fine - 1)])
            for place, count, fine in zip((row, col), self._neutrals.shape[:2], FINE, strict=True)
        )
        return np.asarray(_between(self._neutrals, *places)[0, 0])

    def _samples(self, frame: RawFrame) -> tuple[Array, NDArray[np.bool_]]:
        """Cone responses (row, col, 3) of a grid of pixels, and which of them (row, col) are neither clipped nor dark."""
        table, rule = self._table, self._table.first.rule
        patches, site, labels = self._spread.of(frame)
        classes, signal = rule.on_site(labels, site), self._spread.signal(patches)
        outputs = np.einsum("nct,nt->nc", table.first.weights[classes], signal) + table.first.intercept[classes]
        cones = outputs.astype(np.float64) @ BRADFORD.T
        usable = (rule.lost(rule.split(labels).kind) == 0) & (cones.min(axis=1) > 0)
        shape = self._spread.shape(frame)
        return cones.reshape(*shape, 3), usable.reshape(shape)

    def _log_ratios(self) -> Array:
        """Return the log ratios of whites, as the table shows them, over a fine grid of lights."""
        shown = self._neutrals.reshape(-1, self._neutrals.shape[-1])
        if self._table.camera:
            shown = self._whites.grey.outputs_of(GREY_LEVEL * shown)
        cones = np.maximum(shown @ BRADFORD.T, 1e-9).reshape(len(MIREDS), len(GREENS), 3)
        rows, cols = (np.linspace(0, count - 1, fine) for count, fine in zip(cones.shape[:2], FINE, strict=True))
        return _between(_ratios(cones), rows, cols)


def estimated(cones: Array, usable: NDArray[np.bool_]) -> Array | None:
    """Logarithms of the outer cone responses over the middle one (2) of the white of samples (row, col, 3); None of too few.

    The mean of what two methods find: that the steps between neighbours are grey where they are large (van de Weijer, Gevers
    and Gijsenij, 2007), and that the largest response of each cone is that to white (Land, 1977).
    """
    if int(usable.sum()) < FEWEST:
        return None
    down, across = usable[1:] & usable[:-1], usable[:, 1:] & usable[:, :-1]
    steps = np.concatenate([np.diff(cones, axis=0)[down], np.diff(cones, axis=1)[across]])
    patch = _ratios(np.percentile(cones[usable], PATCH_PERCENTILE, axis=0))
    largest = np.abs(steps).max(axis=0) if len(steps) else np.zeros(3)
    if not largest.min() > 0:
        return patch
    edges = _ratios(largest * ((np.abs(steps) / largest) ** EDGE_NORM).mean(axis=0) ** (1 / EDGE_NORM))
    return (edges + patch) / 2


def _neutrals(table: TransformTable) -> Array:
    """Signals (mired, green, channel) of a grey under lights near daylight and black bodies; of a table without its camera
    XYZ, which it is taken to show."""
    camera = table.camera
    grid = camera.wavelength if camera else correlated_lights.WAVELENGTH
    weights = camera.signal_weights if camera else spectra.xyz_weights(grid)
    lights = [[correlated_lights.radiance(mired, green, grid) for green in GREENS] for mired in MIREDS]
    neutrals = np.array(lights) @ weights.T
    return np.asarray(neutrals / neutrals.max(axis=-1, keepdims=True))


def _ratios(cones: Array) -> Array:
    """Logarithms (…, 2) of the outer cone responses over the middle one, of (…, 3)."""
    return np.log(cones[..., [0, 2]] / cones[..., 1:2])


def _between(values: Array, rows: Array, cols: Array) -> Array:
    """Values (row, col, …) at fractional places `rows` and `cols`, linearly (row, col, …)."""
    low_row = np.clip(rows.astype(int), 0, values.shape[0] - 2)
    low_col = np.clip(cols.astype(int), 0, values.shape[1] - 2)
    down, across = (rows - low_row)[:, None, None], (cols - low_col)[None, :, None]
    upper, lower = values[low_row], values[low_row + 1]
    along = upper[:, low_col] * (1 - down) + lower[:, low_col] * down
    beyond = upper[:, low_col + 1] * (1 - down) + lower[:, low_col + 1] * down
    return np.asarray(along * (1 - across) + beyond * across)
