"""Requirements on greys: no CFA pattern in uniform areas and no colour cast in highlights, at any level."""

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.partial_sums import ClassSums
from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.classes.features import ClassRecipe
from l3cli.classes.rule import make_rule
from l3cli.classes.windows import neighbourhoods
from l3cli.cli import run
from l3cli.frames.frame import RawFrame
from l3cli.physics import spectra
from l3cli.physics.display import lab
from l3cli.rendering.renderer import make_renderer
from l3cli.simulation import sensor
from l3cli.simulation.light import make_light, white_rates
from l3cli.training.highlights import error_of_white, grey_patches, white_channels
from tests.helpers.calls import L3
from tests.helpers.paths import CONFIGS

SCENES = """
illuminants = ["{light}"]
exposure_share = [0.9]
[[scene]]
source = "dead leaves"
size = [128, 128]
count = 6
"""
SMALLER = {"levels": "6", "patches": "2000", "draws": "6", "patch": "{patch}", "mosaics": "24", "rows": "2000"}
# Of full scale, where greys clip: 16-bit weights of two or three round a plane by up to 0.00018 at a site, an output is
# made of two planes, and sites differ both ways.
PLANES_ROUNDED = 4 * 0.00018
EXPOSURES = np.geomspace(0.001, 3.0, 160)  # of that at which a perfect white fills its brightest channel
AREA, MARGIN, ACROSS = 48, 16, 16  # of a ramp's areas: side, rim beyond which no output reaches (pixels), areas a row
EVERY = [("fiveband", "single", "D65", 5), ("bayer", "default", "D65", 5), ("rgbir", "fast", "D65", 5)]
MORE = [
    ("fiveband", "single", "A", 9),
    ("fiveband", "fast", "A", 5),
    ("bayer", "single", "A", 5),
    ("bayer", "fast", "D65", 5),
]  # by make soak


@dataclasses.dataclass(frozen=True)
class Learned:
    """A table learned for a camera and a light."""

    camera: CameraModel
    table: TransformTable
    rates: np.ndarray  # (channel) photo-electrons of white in the time in which its brightest channel fills
    white: np.ndarray  # (output) of the same white, Y = 1
    unit: float  # output Y of that white

    def raw(self, exposure: float, size: int, rng: np.random.Generator) -> RawFrame:
        """A flat grey with noise: how much of `exposure` fills the brightest channel."""
        electrons = np.broadcast_to((self.rates * exposure)[:, None, None], (len(self.rates), size, size)).astype(np.float32)
        mosaic = sensor.mosaic(electrons, self.camera.cfa)
        values = sensor.expose(self.camera, mosaic, 0.0, rng, "all")
        return RawFrame("grey", values, self.camera.black_level, self.camera.white_level)

    def ramp(self, exposures: np.ndarray) -> RawFrame:
        """Flat greys without noise in one frame, for they are many: areas of AREA × AREA, ACROSS a row."""
        grid = np.full((-(-len(exposures) // ACROSS), ACROSS), EXPOSURES[-1])
        grid.flat[: len(exposures)] = exposures
        areas = grid.repeat(AREA, axis=0).repeat(AREA, axis=1)
        mosaic = sensor.mosaic((self.rates[:, None, None] * areas).astype(np.float32), self.camera.cfa)
        values = sensor.expose(self.camera, mosaic, 0.0, np.random.default_rng(0), "none")
        return RawFrame("greys", values, self.camera.black_level, self.camera.white_level)


@pytest.fixture(scope="module")
def training_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Path, str], str]:
    """The training set of a camera and a light, which several recipes of classes learn from."""
    folder = tmp_path_factory.mktemp("scenes")

    @functools.cache
    def simulated(camera: Path, light: str) -> str:
        name = f"{folder}/{camera.stem}-{light}"
        Path(f"{name}.toml").write_text(SCENES.format(light=light))
        assert run(["simulate", f"{name}.toml", "--camera", str(camera), "-o", f"{name}.h5", "--quiet"]) == 0
        return f"{name}.h5"

    return simulated


@pytest.fixture(
    scope="module",
    params=[*EVERY, *(pytest.param(each, marks=pytest.mark.soak) for each in MORE)],
    ids=lambda each: "-".join(map(str, each)),
)
def learned(
    request: pytest.FixtureRequest, training_of: Callable[[Path, str], str], tmp_path_factory: pytest.TempPathFactory
) -> Learned:
    name, classes, light, patch = request.param
    folder = tmp_path_factory.mktemp("greys")
    path = CONFIGS / f"cameras/{name}.toml"
    lines = (CONFIGS / f"classes/{classes}.toml").read_text().splitlines()
    for key, value in SMALLER.items():
        lines = [f"{key} = {value.format(patch=patch)}" if line.startswith(f"{key} ") else line for line in lines]
    (folder / "classes.toml").write_text("\n".join(lines))
    table = str(folder / "table.h5")
    assert run(["train", training_of(path, light), "--classes", str(folder / "classes.toml"), "-o", table, "--quiet"]) == 0
    camera, lamp = load_camera(path), make_light(light, {}, load_camera(path).wavelength)
    rates = white_rates(camera, lamp)
    seconds = camera.full_scale / rates.max()
    unit = seconds / camera.saturation_exposure
    return Learned(camera, load(TransformTable, Path(table)), rates * seconds, spectra.white_point(light), unit)


def site_means(planes: np.ndarray, camera: CameraModel) -> np.ndarray:
    """Mean outputs (site, output) of planes (output, row, col) that begin with the CFA's first site."""
    down, across = camera.cfa.shape
    inner = planes.astype(np.float64)
    return np.array([inner[:, row::down, col::across].mean(axis=(1, 2)) for row in range(down) for col in range(across)])


def areas(planes: np.ndarray, count: int) -> np.ndarray:
    """The inner parts (area, output, row, col) of a ramp's `count` areas, of planes (output, row, col)."""
    each = planes.reshape(len(planes), -1, AREA, ACROSS, AREA).transpose(1, 3, 0, 2, 4)
    return each.reshape(-1, len(planes), AREA, AREA)[:count, :, MARGIN:-MARGIN, MARGIN:-MARGIN]


def test_plain_areas_show_no_pattern_at_any_level(learned: Learned) -> None:
    """Without noise all sites answer alike at every level, on both sides of transitions and through clipping. Only where a
    grey lies on an edge itself do integer means put sites into different classes: at few levels, all of them dark, where
    whole DN put greys beside white's chroma."""
    renderer, raw, on_an_edge = make_renderer("opencl", learned.table), learned.ramp(EXPOSURES), []
    outputs = areas(renderer.outputs(raw), len(EXPOSURES))
    labels = areas(renderer.labels(raw)[None] % learned.table.first.rule.classes_per_site, len(EXPOSURES))
    for exposure, planes, label in zip(EXPOSURES, outputs, labels, strict=True):
        means = site_means(planes, learned.camera)
        if np.unique(label).size > 1:
            on_an_edge.append(exposure)
        else:
            rounded = PLANES_ROUNDED if learned.table.later else 0.0
            assert (np.ptp(means, axis=0) <= 1e-4 * means.mean(axis=0) + rounded).all(), exposure
    assert len(on_an_edge) <= 0.08 * len(EXPOSURES), np.round(on_an_edge, 4)


def test_plain_areas_show_no_pattern_under_noise(learned: Learned) -> None:
    """Noise sorts the pixels of a plain area into different classes, at some sites more often than at others: within 0.2 %
    and what the mean of so many pixels can be off by chance; up to 1.1 % in the dark, where noise decides the class, and
    where a channel is just about to clip, or 2.5 % if plain areas have no classes for themselves there (docs/limits.md)."""
    renderer, rng = make_renderer("opencl", learned.table), np.random.default_rng(3)
    clip = learned.rates / learned.rates.max()
    for exposure in (0.01, 0.03, 0.1, 0.2, 0.4, 0.6, 0.8, 1.05, 1.15, 1.3, 1.5, 2.0, 3.0):
        planes = renderer.outputs(learned.raw(exposure, 272, rng))
        means = site_means(planes[:, 8:-8, 8:-8], learned.camera)
        count = 256**2 / learned.camera.cfa.size
        chance = planes[:, 8:-8, 8:-8].std(axis=(1, 2)) * 4.5 / np.sqrt(count)  # the spread of up to 16 means
        about_to_clip = (np.abs(exposure * clip - 0.99) < 0.04).any()
        most_clip = (exposure * clip > 1).mean() > 0.5  # classes of edges answer greys a little otherwise than plain ones
        bound = 0.011 if about_to_clip or most_clip or exposure <= 0.01 else 0.002
        if about_to_clip and learned.table.first.rule.contrasts == 1:
            bound = 0.025  # less than one step of L*
        spread = np.ptp(means, axis=0) / means.mean(axis=0)
        assert (spread <= bound + chance / means.mean(axis=0)).all(), (exposure, spread)


def test_highlights_have_no_cast(learned: Learned) -> None:
    """A grey ramp through clipping stays grey and rises; where all channels clip it is white to 0.003 in x, y."""
    renderer = make_renderer("opencl", learned.table)
    all_clip = learned.rates.max() / learned.rates.min()  # the exposure from which every channel clips
    exposures = np.append(EXPOSURES[(EXPOSURES > 0.3) & (all_clip > EXPOSURES)], all_clip * np.array([1.03, 1.1, 1.3, 1.6]))
    ramp = areas(renderer.outputs(learned.ramp(exposures)), len(exposures)).mean(axis=(2, 3))
    assert np.isfinite(ramp).all()
    assert ramp.min() > 0
    shown = ramp / learned.unit  # Y = 1: the white that just fills its brightest channel
    shown_lab = lab(shown / np.maximum(shown.max(axis=1, keepdims=True) / 4.0, 1.0), learned.white)
    chroma = np.hypot(shown_lab[:, 1], shown_lab[:, 2])
    assert chroma.max() < 4.0, f"{chroma.max():.1f} at {exposures[chroma.argmax()]:.2f}"
    assert (np.diff(shown[:, 1]) > -0.01 * shown[:-1, 1]).all()  # steps between levels and kinds, hidden by any noise
    clipped = exposures > 1.02 * all_clip
    x, y = (shown[clipped, :2] / shown[clipped].sum(axis=1, keepdims=True)).T
    white = learned.white / learned.white.sum()
    assert x == pytest.approx(np.full(x.size, white[0]), abs=0.003)
    assert y == pytest.approx(np.full(y.size, white[1]), abs=0.003)


def test_greys_are_grey_at_every_level(learned: Learned) -> None:
    """C*ab of plain greys of the training light, from the dark to clipping, without noise. In the dark a DN is a colour."""
    renderer, step = make_renderer("opencl", learned.table), learned.camera.white_level - learned.camera.black_level
    exposures = EXPOSURES[EXPOSURES < 0.98]
    ramp = areas(renderer.outputs(learned.ramp(exposures)), len(exposures)).mean(axis=(2, 3))
    shown = lab(ramp / (learned.unit * exposures[:, None]), learned.white)  # each as bright as white
    chroma = np.hypot(shown[:, 1], shown[:, 2])
    rounding = 300.0 / (step * exposures * learned.rates.min() / learned.rates.max())  # half a DN in one channel
    assert (chroma < 0.5 + rounding).all(), (
        f"{(chroma - rounding).max():.2f} at {exposures[(chroma - rounding).argmax()]:.3f}"
    )
    assert chroma[exposures > 0.3].max() < 0.5


def test_clipped_areas_of_a_picture_are_neither_black_nor_magenta(tmp_path: Path, l3: L3, learned: Learned) -> None:
    """Bright neutral bars and patches beside dark ones at 1.5 times full exposure, with noise."""
    rows = np.arange(96)[:, None] // 24 % 2
    share = np.where(rows ^ (np.arange(96)[None] // 24 % 2), 1.5, 0.4)
    electrons = (learned.rates[:, None, None] * share).astype(np.float32)
    rng = np.random.default_rng(1)
    values = sensor.expose(learned.camera, sensor.mosaic(electrons, learned.camera.cfa), 0.0, rng, "all")
    raw = RawFrame("bars", values, learned.camera.black_level, learned.camera.white_level)
    planes = make_renderer("opencl", learned.table).outputs(raw) / learned.unit
    assert np.isfinite(planes).all()
    assert planes[1][share > 1].min() > 0.2
    inside = np.zeros_like(share, dtype=bool)
    for top in range(0, 96, 24):
        for left in range(0, 96, 24):
            inside[top + 6 : top + 18, left + 6 : left + 18] = True
    bright = planes[:, inside & (share > 1)].mean(axis=1)
    bright_lab = lab(bright, learned.white)
    assert np.hypot(bright_lab[1], bright_lab[2]) < 5.0


def test_surfaces_mislead_about_white_where_a_camera_sees_infrared() -> None:
    """There the signals of white are those of its light, however surfaces look; elsewhere surfaces speak against a lens."""
    for name, least, most in (("bayer", 0.0, 0.1), ("fiveband", 0.0, 0.1), ("rgbir", 0.3, 3.0)):
        camera = load_camera(CONFIGS / f"cameras/{name}.toml")
        skewed = error_of_white(make_light("D65", {}, camera.wavelength).spectrum, camera)
        assert skewed.min() >= least
        assert skewed.max() < most


def test_greys_are_taught_only_where_they_clip(bayer: CameraModel) -> None:
    """Sums of grey patches alone: white's channels follow from them, and every taught row is a clipped grey."""
    cases = np.arange(8).astype(np.uint16)
    rule = make_rule(ClassRecipe(patch=3, levels=6), bayer, cases)
    window = neighbourhoods(bayer.cfa, 3, 3).channel[0]
    signal, white = np.array([0.6, 1.0, 0.8]), np.array([0.95, 1.0, 1.09])
    columns = np.concatenate([signal[window], [1.0], white])
    row, col = np.triu_indices(columns.size)
    sums = ClassSums(
        np.zeros((rule.classes_per_site, row.size)), np.zeros((rule.classes_per_site, 9)), np.ones(rule.classes_per_site)
    )
    assert grey_patches(sums, rule, window, white, bayer.black_level, bayer.white_level, None) == {}
    sums.moments[0] = columns[row] * columns[col]
    estimated_signal = white_channels(sums, rule, window, white, None)
    taught = grey_patches(sums, rule, window, white, bayer.black_level, bayer.white_level, estimated_signal)
    assert taught
    for index, moments in taught.items():
        kind = index % rule.kinds
        assert kind >= rule.chromas
        saturated = [channel for channel in range(3) if kind - rule.chromas + 1 >> channel & 1]
        assert 1 in saturated  # green clips first
        taps = np.sqrt(np.diag(moments)[:9] / moments[9, 9])
        assert taps[np.isin(window, saturated)] == pytest.approx(1.0, abs=0.08)
        if len(saturated) == 3:
            assert taps == pytest.approx(1.0)
        outputs = moments[10:, 9] / moments[9, 9]
        assert outputs / outputs[1] == pytest.approx(white)
