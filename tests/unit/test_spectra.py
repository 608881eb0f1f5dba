"""Resampled spectra: values between the samples of the new grid are neither lost nor counted twice."""

import dataclasses
import json
import re
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import l3cli
from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_curves import column_faults
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.store import save
from l3cli.calibration import captures, responsivity
from l3cli.errors import InputFileError
from l3cli.frames.measurement import BandCapture
from l3cli.frames.scene import Scene, SpectralCube
from l3cli.io.curves import read_cameras, read_finished
from l3cli.io.scenes.iset import read as read_iset_scene
from l3cli.physics import spectra
from l3cli.recipes.builtin import known_recipes
from l3cli.simulation import light, recipe
from l3cli.simulation.light import make_target, output_weights
from l3cli.simulation.sources import Cube, scene_of, source_faults
from l3cli.spectra.file import read_table
from l3cli.stages import evaluation
from l3cli.system.console import Gathering, Silent
from tests.helpers.calls import L3
from tests.helpers.cameras import bayer_camera
from tests.helpers.paths import CONFIGS
from tests.helpers.tables import colorimetric_table

HALVES = np.arange(380.0, 780.1, 0.5)
SEEN = np.arange(400.0, 701.0, 10.0)


def lamp(*lines: float, grid: np.ndarray = HALVES, ground: float = 1.0) -> np.ndarray:
    """Power (1, wavelength) of a lamp with lines of 150 ground levels × nm each at samples of `grid`."""
    power = np.full(grid.size, ground)
    for line in lines:
        index = int(np.abs(grid - line).argmin())
        power[index] += 150.0 * ground / spectra.bin_widths(grid)[index]
    return power[None]


def chromaticity(xyz: np.ndarray) -> np.ndarray:
    return xyz[:2] / xyz.sum()


def summed_up(grid: np.ndarray, power: np.ndarray) -> np.ndarray:
    """XYZ of a table, summed over its samples."""
    return spectra.colour_matching_functions(grid) @ (power * spectra.bin_widths(grid))


@pytest.mark.parametrize("line", [546.5, 546.0, 435.5, 611.5])
@pytest.mark.parametrize("turned", [1, -1])
def test_a_line_between_two_nanometres_counts(line: float, turned: int, tmp_path: Path) -> None:
    power = lamp(line)
    table = np.vstack([HALVES, power])[:, ::turned].T
    (tmp_path / "lamp.csv").write_text("".join(f"{x},{y}\n" for x, y in table))
    curve = read_table(tmp_path / "lamp.csv")
    made = light.make_light("lamp.csv", {"lamp.csv": (curve.wavelength, curve.values)}, SEEN)
    xyz = spectra.xyz_weights(made.wavelength) @ made.radiance
    assert np.allclose(chromaticity(xyz), chromaticity(summed_up(HALVES, power[0])), atol=1e-5)
    if line == 546.5:
        assert np.allclose(chromaticity(xyz), (0.311, 0.483), atol=1e-3)


# --------------------------------------------------------------------------------------------------- the mechanism


@st.composite
def grids(draw: Callable, least: int = 1, within: tuple[float, float] = (400.0, 700.0)) -> np.ndarray:
    """A grid of uneven steps, rising or falling, that may be far finer or coarser than another."""
    steps = np.array(draw(st.lists(st.floats(0.05, 60.0), min_size=least, max_size=40)))
    first, last = within
    grid = first + (last - first) * np.cumsum(steps) / (steps.sum() + steps[0])
    return grid[:: draw(st.sampled_from([1, -1]))]


@settings(max_examples=80, deadline=None)
@given(grids(), grids(least=2, within=(200.0, 1000.0)), st.integers(0, 2**32 - 1))
def test_power_is_kept_on_any_grid(source: np.ndarray, grid: np.ndarray, seed: int) -> None:
    wide = np.concatenate([[100.0, 150.0], np.sort(grid), [1100.0, 1150.0]])[:: np.sign(grid[1] - grid[0]).astype(int)]
    power = np.random.default_rng(seed).random((3, source.size)) ** 8
    resampled = spectra.resample(power, source, wide)
    assert (resampled >= 0).all()
    total = (power * spectra.bin_widths(source)).sum(axis=1)
    assert np.allclose((resampled * spectra.bin_widths(wide)).sum(axis=1), total, rtol=1e-6)
    same = spectra.resample(power, source, source)
    assert np.allclose(same, power, rtol=1e-9, atol=1e-12)
    assert np.allclose(spectra.average(np.ones(source.size), source, grid)[inside(grid, source)], 1.0, rtol=1e-9)
    assert np.allclose(spectra.resample(np.ones(wide.size), wide, source), 1.0, rtol=1e-9)


def inside(grid: np.ndarray, source: np.ndarray) -> np.ndarray:
    return (grid >= source.min()) & (grid <= source.max())


def test_a_finer_grid_is_interpolation_and_a_line_keeps_its_place() -> None:
    coarse, fine = np.arange(400.0, 701.0, 5.0), np.arange(380.0, 721.0, 1.0)
    curve = np.random.default_rng(0).random(coarse.size)
    inner = slice(20, -20)
    assert np.allclose(spectra.resample(curve, coarse, fine)[inner], np.interp(fine, coarse, curve)[inner], rtol=1e-12)
    grid = np.arange(380.0, 780.0, 0.01)
    for line in (546.07, 546.25, 546.93):
        power = np.where(np.isclose(grid, line), 1.0, 0.0)
        resampled = spectra.resample(power, grid, fine)
        assert resampled @ fine / resampled.sum() == pytest.approx(line, abs=1e-6)


@pytest.mark.parametrize("grid", [[400.0, 500.0, 500.0], [500.0, 400.0, 500.0]])
def test_a_wavelength_twice_is_refused(grid: list[float]) -> None:
    with pytest.raises(ValueError, match="occurs twice"):
        spectra.resample(np.ones(3), np.array(grid), SEEN)
    with pytest.raises(ValueError, match="occurs twice"):
        spectra.resample(np.ones(SEEN.size), SEEN, np.array(grid))


# ----------------------------------------------------------------------------------------------------- its places


def test_a_lamp_of_lines_gives_a_camera_all_its_light(bayer: CameraModel) -> None:
    """Electrons and luminance against the sums over the table's 0.1 nm."""
    grid = np.arange(380.0, 780.05, 0.1)
    power = lamp(435.8, 546.1, 577.0, 579.1, 611.3, grid=grid, ground=0.01)
    made = light.make_light("lamp.csv", {"lamp.csv": (grid, power)}, bayer.wavelength)
    first, last = spectra.bin_edges(bayer.wavelength)[[0, -1]]
    curves = np.array([np.interp(grid, bayer.wavelength, curve) for curve in bayer.responsivity])
    curves *= (grid >= first) & (grid <= last)
    curves *= bayer.electron_weights.max() / (bayer.responsivity * spectra.bin_widths(bayer.wavelength)).max()
    photons = spectra.photons_from_energy(grid, power[0])
    expected = curves @ (photons * spectra.bin_widths(grid)) / (spectra.xyz_weights(grid)[1] @ photons)
    assert np.allclose(light.white_rates(bayer, made), expected, rtol=1e-4)


def test_a_scene_of_finer_bands_than_the_cameras_has_electrons(bayer: CameraModel) -> None:
    """Its bands end where the camera still has samples: these see nothing, and are no 0 / 0."""
    bands = np.arange(430.0, 671.0, 1.0)
    scene = Scene("fine", bands, np.ones((16, 16, bands.size), np.float32), np.ones(bands.size))
    rates = light.white_rates(bayer, light.scene_light(scene, 10.0))
    coarse = bands[::5]
    scene = Scene("coarse", coarse, np.ones((16, 16, coarse.size), np.float32), np.ones(coarse.size))
    assert np.allclose(rates, light.white_rates(bayer, light.scene_light(scene, 10.0)), rtol=0.02)


def test_a_cube_is_divided_by_all_of_its_light() -> None:
    """A line between two bands lights both; a light on the cube's bands leaves a white tile white."""
    ramp = np.linspace(0.2, 0.8, 31)
    fine = lamp(546.5)
    bands = np.array([fine[0] @ np.maximum(0, 1 - abs(HALVES - x) / 10) / 20 for x in SEEN])  # of 10 nm half width
    for grid, power in ((HALVES, fine), (SEEN, bands[None]), (SEEN[::-1], bands[None, ::-1])):
        falling = light.recorded_under("lamp.csv", {"lamp.csv": spectra.ascending(grid, power)}, SEEN)
        cube = SpectralCube((bands * ramp * np.ones((16, 16, 1))).astype(np.float32), SEEN)
        reflectance = scene_of(cube, Cube(file="x", holds="radiance", light="lamp.csv"), "x", falling).reflectance[0, 0]
        assert np.allclose((reflectance / ramp)[1:-1], (reflectance / ramp)[1], rtol=2e-3)


@pytest.mark.parametrize("listed_in_recipe", [True, False])
def test_bands_that_fall_are_turned_round(listed_in_recipe: bool, bayer: CameraModel) -> None:
    values = np.random.default_rng(0).random((16, 16, 31)).astype(np.float32)
    listed = {"wavelengths_nm": SEEN[::-1].tolist()} if listed_in_recipe else {}
    source = Cube(file="x", **listed)
    assert not list(source_faults(source, bayer, "scene 1"))
    scene = scene_of(SpectralCube(values[..., ::-1], None if listed_in_recipe else SEEN[::-1]), source, "x", None)
    assert np.array_equal(scene.wavelength, SEEN)
    assert np.array_equal(scene.reflectance, values)


def test_an_iset_scene_that_falls_is_turned_round(tmp_path: Path) -> None:
    from scipy.io import savemat

    values, white = np.random.default_rng(0).random((16, 16, 31)), np.linspace(1.0, 2.0, 31)
    for turn, light_step in ((1, 1), (-1, -1), (1, -1), (-1, 1)):
        of_light = {"data": {"photons": white[::light_step]}, "spectrum": {"wave": SEEN[::light_step]}}
        savemat(tmp_path / "scene.mat", {"photons": values[..., ::turn], "wave": SEEN[::turn], "illuminant": of_light})
        scene = read_iset_scene(tmp_path / "scene.mat")
        assert np.array_equal(scene.wavelength, SEEN)
        assert scene.illuminant is not None
        assert np.allclose(scene.illuminant, white)
        assert np.allclose(scene.reflectance, values / white, rtol=1e-6)


def narrow(centre: float) -> np.ndarray:
    return np.exp(-0.5 * (HALVES - centre) ** 2)


CENTRES = (550.0, 552.5, 555.0)
WIDTH = np.sqrt(2 * np.pi)  # nm, the area of a narrow band


def test_a_narrow_responsivity_between_the_cameras_samples_counts(tmp_path: Path, bayer_recipe: Path) -> None:
    text = bayer_recipe.read_text()
    gaussians = text[text.index("[responsivity.gaussians]") : text.index("[noise]")]
    (tmp_path / "camera.toml").write_text(text.replace(gaussians, 'file = "curves.csv"\n'))
    for centre in CENTRES:
        table = np.stack([HALVES, np.ones(HALVES.size), narrow(centre), narrow(centre)], axis=1)
        np.savetxt(tmp_path / "curves.csv", table, delimiter=",")
        flat, band, _ = load_camera(tmp_path / "camera.toml").responsivity * 10.0  # nm
        assert band.sum() / flat[0] * 10.0 == pytest.approx(WIDTH, rel=1e-3)


def test_a_narrow_filter_between_the_cameras_samples_counts(bayer: CameraModel) -> None:
    lens = recipe.SceneRecipe(lens=recipe.Lens(transmittance="filter.csv"))
    for centre in CENTRES:
        after = recipe.set_up(bayer, lens, {"filter.csv": (HALVES, narrow(centre)[None])})
        expected = [np.interp(centre, bayer.wavelength, curve) * WIDTH for curve in bayer.responsivity]
        assert np.allclose(after.responsivity.sum(axis=1) * 10.0, expected, rtol=0.05)  # it is seen by 20 nm of a tail


def test_narrow_functions_and_reflectances_between_a_lights_samples_count(bayer: CameraModel) -> None:
    equal = light.Light("E", 1.0, SEEN, np.ones(SEEN.size))
    for centre in CENTRES:
        target = make_target("f.csv", (HALVES, narrow(centre)[None]), ("f",), None, bayer)
        per_photon = output_weights(target, bayer, equal, SEEN) @ (SEEN / 550.0)
        joule = spectra.PLANCK * spectra.LIGHT_SPEED / 550e-9
        assert per_photon[0] == pytest.approx(spectra.LUMINOUS_EFFICACY * joule * WIDTH, rel=1e-3)
        reflected = spectra.held_interpolation(HALVES, SEEN) @ narrow(centre)
        assert reflected.sum() * 10.0 == pytest.approx(WIDTH, rel=1e-3)


def test_coarse_spectra_light_every_node() -> None:
    """Spectra every 10 nm on nodes every 5: those between the samples get their share."""
    nodes = np.arange(400.0, 701.0, 5.0)
    radiance = np.ones(31)
    photons = responsivity.node_photons(SEEN, radiance, nodes)
    assert np.allclose(photons[1:-1], 5.0)
    assert photons.sum() == pytest.approx(305.0)  # what lies within the nodes' steps


def test_a_bands_centre_does_not_depend_on_where_it_was_sampled_most() -> None:
    grid = np.concatenate([np.arange(500.0, 550.0, 0.5), np.arange(550.0, 601.0, 5.0)])
    shape = np.maximum(0.0, 1.0 - np.abs(grid - 550.0) / 40.0) * np.ones((24, 1))
    capture = BandCapture("b", 1.0, [], "filter", np.zeros((4, 2)), grid, shape)
    assert captures.band_centre(capture) == pytest.approx(550.0, abs=1.0)


# ----------------------------------------------------------------------------------------------------------- files


def test_a_table_that_falls_is_read_and_one_out_of_order_refused(tmp_path: Path) -> None:
    path = tmp_path / "curve.csv"
    path.write_text("nm,a,b\n500,1,2\n450,3,4\n400,5,6\n")
    curves = read_table(path)
    assert curves.wavelength.tolist() == [400.0, 450.0, 500.0]
    assert curves.values.tolist() == [[5.0, 3.0, 1.0], [6.0, 4.0, 2.0]]
    for wrong in ("500,1\n400,2\n450,3\n", "500,1\n450,2\n450,3\n", "400,1\n400,2\n"):
        path.write_text(wrong)
        with pytest.raises(InputFileError, match="not in order"):
            read_table(path)


@pytest.mark.parametrize("wavelength", [np.arange(850.0, 1001.0, 5.0), np.arange(200.0, 351.0, 5.0)])
def test_a_camera_that_sees_nothing_visible_has_no_saturation_exposure(bayer: CameraModel, wavelength: np.ndarray) -> None:
    def seeing(wavelength: np.ndarray) -> CameraModel:
        curves = np.full((3, wavelength.size), 0.3)
        return dataclasses.replace(bayer, wavelength=wavelength, responsivity=curves, responsivity_band=0 * curves)

    with pytest.raises(InputFileError, match=rf"camera small Bayer: .*light at {wavelength[0]:g}.*380 to 780 nm"):
        _ = seeing(wavelength).saturation_exposure
    assert seeing(np.arange(750.0, 1001.0, 5.0)).saturation_exposure > 0


@pytest.mark.parametrize("heading", ["nm,Blue,Red,Green", "nm,b,r,g", "nm,B,red,G"])
@pytest.mark.parametrize(
    ("channels", "columns"),
    [(("r", "g", "b"), {}), (("r", "g", "b"), {"red": "Red", "Green": "green"}), (("red", "green", "blue"), {"r": "red"})],
)
def test_channels_are_called_by_letter_or_name(
    tmp_path: Path, heading: str, channels: tuple[str, ...], columns: dict[str, str]
) -> None:
    (tmp_path / "a.csv").write_text(f"{heading}\n400,3,1,2\n500,6,2,4\n600,9,3,6\n")
    curves = read_finished(tmp_path / "a.csv", channels, per_energy=False, columns=columns)
    np.testing.assert_array_equal(curves.responsivity[:, 0], [1, 2, 3])
    assert not list(column_faults(columns, channels, "columns"))
    assert list(column_faults({"violet": "a"}, channels, "columns"))


def test_a_prior_takes_red_green_and_blue(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("nm,Red,Green,Blue\n400,1,2,3\n500,2,4,6\n600,3,6,9\n")
    (curves,) = read_cameras([tmp_path / "a.csv"])
    np.testing.assert_allclose(curves.responsivity[:, 0] * 400, [1, 2, 3])


def test_lights_that_formulas_define_are_computed_beyond_their_tables() -> None:
    """CIE A by its formula, D65 by the CIE's own values up to 830 nm (CIE 15), E is equal everywhere."""
    grid = np.array([560.0, 800.0, 830.0, 1000.0])

    def energy(name: str) -> np.ndarray:
        power = spectra.illuminant(name, grid) / grid  # photons → energy
        return power / power[0]

    formula = grid**-5 / (np.exp(1.435e7 / (2848 * grid)) - 1)
    np.testing.assert_allclose(energy("A"), formula / formula[0], rtol=1e-9)
    fine = np.arange(300.0, 831.0)
    daylight = spectra.illuminant("D65", fine) / fine
    np.testing.assert_allclose(daylight[[500, 530]] / daylight[260], [0.594519, 0.603125], rtol=1e-4)
    np.testing.assert_allclose(energy("E"), 1.0)


@pytest.mark.parametrize(
    ("light", "source", "warned"), [("A", "grey ramp", False), ("F2", "grey ramp", True), ("A", "skin", True)]
)
def test_what_is_held_constant_where_a_channel_sees_it_is_said(
    light: str, source: str, warned: bool, tmp_path: Path, l3: L3
) -> None:
    """The share of the channel's electrons is that of a sum of its own."""
    text = bayer_camera().replace("[400, 700, 10]", "[400, 900, 10]").replace("centre_nm = 600", "centre_nm = 760")
    (tmp_path / "camera.toml").write_text(text)
    (tmp_path / "scenes.toml").write_text(
        f'illuminants = ["{light}"]\nexposure_share = [0.9]\n[[scene]]\nsource = "{source}"\nsize = [32, 48]\n'
    )
    call = ("simulate", tmp_path / "scenes.toml", "--camera", tmp_path / "camera.toml", "-o", tmp_path / "set.h5")
    code, _, err = l3(*call)
    assert code == 0
    warnings = [line for line in err.splitlines() if line.startswith("warning")]
    assert len(warnings) == warned
    if warned:
        camera, grid = load_camera(tmp_path / "camera.toml"), np.arange(400.0, 901.0)
        seen = np.array([np.interp(grid, camera.wavelength, each) for each in camera.responsivity])
        seen = seen * spectra.illuminant(light, grid)
        shares = seen[:, grid > 780].sum(axis=1) / seen.sum(axis=1)
        channel = int(shares.argmax())
        stated = re.search(r"channel (\w+) collects (\d+)% of its electrons", warnings[0])
        assert stated is not None
        assert stated[1] == camera.channels[channel]
        assert int(stated[2]) == pytest.approx(100 * shares[channel], abs=2)


def infrared_camera(folder: Path) -> CameraModel:
    """A camera in camera.toml whose third channel sees 760 nm, beyond the tables of most lamps."""
    text = bayer_camera().replace("[400, 700, 10]", "[400, 900, 10]").replace("centre_nm = 600", "centre_nm = 760")
    (folder / "camera.toml").write_text(text)
    return load_camera(folder / "camera.toml")


def share_outside(camera: CameraModel, light: str, first: float, last: float) -> tuple[str, float]:
    """The channel that collects the largest share of its electrons beyond two wavelengths, and the share."""
    grid = np.arange(400.0, 901.0)
    seen = np.array([np.interp(grid, camera.wavelength, each) for each in camera.responsivity])
    seen = seen * spectra.illuminant(light, grid)
    shares = seen[:, (grid < first) | (grid > last)].sum(axis=1) / seen.sum(axis=1)
    return camera.channels[int(shares.argmax())], float(shares.max())


def require_stated(text: str, camera: CameraModel, light: str, first: float = 400, last: float = 780) -> None:
    """A warning names the channel and its share."""
    channel, share = share_outside(camera, light, first, last)
    stated = re.search(r"channel (\w+) (?:collects|would collect) (\d+)% of its electrons", text)
    assert stated is not None
    assert stated[1] == channel
    assert int(stated[2]) == pytest.approx(100 * share, abs=2)


LIT = 'illuminants = ["F2"]\nexposure_share = [0.9]\n[[scene]]\nsource = "grey ramp"\nsize = [64, 64]\n'
PIXEL = """name = "one"
pixel = { camera = "camera.toml", bare = 0.5 }
pattern = [{ shape = [2, 2], filters = ["r", "g", "b"] }]
level = [{ illuminant = "F2", share = 0.9 }]
filters = { r = { channel = "r" }, g = { channel = "g" }, b = { channel = "b" } }
"""


def test_every_command_that_takes_a_light_says_where_it_is_not_known(
    tmp_path: Path, l3: L3, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(evaluation, "document_of", lambda *_: {})  # figures take long
    monkeypatch.setattr(evaluation, "warn_of_other_lights", lambda *_: None)
    camera = infrared_camera(tmp_path)
    (tmp_path / "scenes.toml").write_text(LIT)
    (tmp_path / "design.toml").write_text(PIXEL)
    save(colorimetric_table(camera), tmp_path / "table.h5")
    np.save(tmp_path / "raw.npy", np.full((camera.rows, camera.cols), 900, np.uint16))

    def warnings(*call: object) -> list[str]:
        code, out, err = l3(*call)
        assert code == 0, err
        return [line for line in (out + err).splitlines() if line.strip().startswith("warning: illuminant F2")]

    frames = tmp_path / "frames.h5"
    moments, pixel = tmp_path / "moments.h5", tmp_path / "design.toml"
    render = ("render", tmp_path / "table.h5", tmp_path / "raw.npy", "--backend", "reference", "-o", tmp_path / "a.png")
    calls = [
        ("check", tmp_path / "camera.toml", tmp_path / "scenes.toml"),
        ("check", tmp_path / "design.toml"),
        ("simulate", tmp_path / "scenes.toml", "--camera", tmp_path / "camera.toml", "-o", frames),
        ("evaluate", tmp_path / "table.h5", frames, "--backend", "reference", "--json"),
        ("design", "moments", tmp_path / "scenes.toml", "--camera", pixel, "-o", moments, "--patches", 200),
        ("design", tmp_path / "design.toml", "--moments", moments, "-o", tmp_path / "design.h5"),
        (*render, "--white", "F2"),
        ("export", tmp_path / "table.h5", "--to", "c", "--white", "F2", "-o", tmp_path / "c"),
    ]
    for call in calls:
        (warning,) = warnings(*call)
        require_stated(warning, camera, "F2")
    assert warnings(*render, "--white", "A", "--force") == []


def test_python_warns_of_lights_as_the_commands_do(tmp_path: Path) -> None:
    """Stages without a console, and a renderer, which takes the white by name: one warning at the line of the caller."""
    camera = infrared_camera(tmp_path)
    table = colorimetric_table(camera)
    (tmp_path / "scenes.toml").write_text(LIT)
    save(table, tmp_path / "table.h5")
    values = np.full((camera.rows, camera.cols), 900, np.uint16)
    np.save(tmp_path / "raw.npy", values)
    renderer = l3cli.Renderer(table, backend="reference")
    files = tmp_path / "table.h5", tmp_path / "raw.npy", tmp_path / "a.png"
    calls: list[Callable[[], object]] = [
        lambda: l3cli.simulate(tmp_path / "scenes.toml", tmp_path / "camera.toml", tmp_path / "set.h5"),
        lambda: l3cli.render(*files, white="F2", backend="reference"),
        lambda: renderer.picture(values, white="F2"),
        lambda: list(renderer.pictures([values, values], white="F2")),
        lambda: renderer.sequence(None, white="F2")(values),
    ]
    for call in calls:
        with pytest.warns(UserWarning, match="F2") as told:
            call()
        (warning,) = [each for each in told if "illuminant F2" in str(each.message)]
        require_stated(str(warning.message), camera, "F2")
        assert warning.filename == __file__
    heard = Gathering(Silent(), 9)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        l3cli.render(*files, white="F2", backend="reference", force=True, console=heard)
        renderer.picture(values, white="A")
    assert any("illuminant F2" in each for each in heard.warnings)


def test_files_that_end_where_a_channel_sees_are_said(tmp_path: Path, l3: L3) -> None:
    """A lens, matching functions and the camera's own curves: what would be there if they went on as they end."""
    camera = infrared_camera(tmp_path)
    (tmp_path / "lens.csv").write_text("nm,lens\n400,0.8\n730,0.8\n")
    (tmp_path / "outputs.csv").write_text("nm,one,two\n400,1,0\n500,1,0\n600,0,1\n700,0,1\n")
    grid = np.arange(400, 741, 10)
    rows = [f"{nm}," + ",".join(f"{value:.6f}" for value in camera.responsivity[:, place]) for place, nm in enumerate(grid)]
    head = ",".join(f"{name} (e-/photon)" for name in camera.channels)
    (tmp_path / "curves.csv").write_text(f"nm,{head}\n" + "\n".join(rows) + "\n")
    own = (tmp_path / "camera.toml").read_text()
    start, end = own.index("[responsivity]"), own.index("[noise]")
    (tmp_path / "own.toml").write_text(
        own[:start] + '[responsivity]\nfile = "curves.csv"\nwavelength_nm = [400, 900, 10]\n' + own[end:]
    )
    scenes = LIT.replace("F2", "A")
    (tmp_path / "lens.toml").write_text(f'lens.transmittance = "lens.csv"\n{scenes}')
    (tmp_path / "outputs.toml").write_text(f'target.outputs = "outputs.csv"\n{scenes}')
    (tmp_path / "scenes.toml").write_text(scenes)

    def warned(camera_file: str, scenes_file: str) -> str:
        call = ("--camera", tmp_path / camera_file, "-o", tmp_path / "set.h5", "--force")
        code, _, err = l3("simulate", tmp_path / scenes_file, *call)
        assert code == 0, err
        (line,) = [line for line in err.splitlines() if line.startswith("warning")]
        return line

    require_stated(warned("camera.toml", "lens.toml"), camera, "A", last=730)
    stated = re.search(r"outputs.csv .* output two would have (\d+)%", warned("camera.toml", "outputs.toml"))
    every = np.arange(360.0, 901.0)
    weights = np.interp(every, [500, 600], [0, 1]) * spectra.illuminant("A", every) / every
    assert stated is not None
    assert int(stated[1]) == pytest.approx(100 * weights[every > 700].sum() / weights.sum(), abs=1)
    held = dataclasses.replace(
        camera, responsivity=np.where(camera.wavelength > 740, camera.responsivity[:, [34]], camera.responsivity)
    )
    require_stated(warned("own.toml", "scenes.toml"), held, "A", last=740)
    meaning = json.loads(l3("check", tmp_path / "own.toml", "--json")[1])["files"][0]["meaning"]
    assert any("curves.csv" in each for each in meaning["warnings"])


def test_a_pixel_of_an_infrared_camera_fills_under_a_as_its_formula_says(tmp_path: Path, l3: L3) -> None:
    """Up to 1050 nm; the table of A, held constant beyond 780 nm, gives longer times."""
    text = known_recipes("cameras")["rgbir"].read_text().replace("[390, 830, 5]", "[390, 1050, 5]")
    (tmp_path / "camera.toml").write_text(text)
    camera, grid = load_camera(tmp_path / "camera.toml"), np.arange(360.0, 1051.0)
    luminous = np.interp(grid, *observer())

    def filled(power: np.ndarray) -> float:
        radiance = power / (683.0 * np.sum(power * luminous)) * grid * 1e-9 / (6.62607015e-34 * 2.99792458e8)
        weights = np.array([np.interp(grid, camera.wavelength, each, 0, 0) for each in camera.responsivity])
        photons = radiance * camera.pixel_pitch**2 * camera.optics.irradiance_per_radiance
        return camera.full_scale / (weights @ photons).max()

    planck = grid**-5.0 / (np.exp(1.435e7 / (2848 * grid)) - 1)
    meaning = json.loads(l3("check", tmp_path / "camera.toml", "--json")[1])["files"][0]["meaning"]
    stated = meaning["saturation_exposure_cd_s_per_m2"]["A"]
    assert stated == pytest.approx(filled(planck), rel=3e-3)
    assert filled(np.where(grid > 780, planck[420], planck)) > 1.02 * stated
    assert ["illuminant D65" in each for each in meaning["warnings"]] == [True]


def observer() -> tuple[np.ndarray, np.ndarray]:
    """Wavelengths (nm) and V(λ)."""
    grid = np.arange(360.0, 831.0)
    return grid, spectra.colour_matching_functions(grid)[1]


def test_curves_that_end_before_the_infrared_are_said(tmp_path: Path, l3: L3) -> None:
    """Without wavelength_nm, the camera has the wavelengths of its file. The warning still counts what lies beyond them."""
    text = (CONFIGS / "cameras/from_curves.toml").read_text().replace("from_curves.csv", "curves.csv")
    (tmp_path / "camera.toml").write_text(text)
    nm = np.arange(400.0, 701.0, 10)
    shape = np.exp(-0.5 * ((nm[:, None] - [600, 540, 460]) / 30) ** 2)

    def stated(end: float) -> list[str]:
        percent = np.maximum(50 * shape, [end, 0, 0])
        percent[0] = 0
        rows = [",".join(f"{value:.4f}" for value in row) for row in np.column_stack([nm, percent])]
        (tmp_path / "curves.csv").write_text("\n".join(["wavelength_nm,r (%),g (%),b (%)", *rows]) + "\n")
        code, out, _ = l3("check", tmp_path / "camera.toml")
        assert code == 0
        return [line for line in out.splitlines() if "curves.csv contains values" in line]

    (line,) = stated(8)
    curve, grid = np.maximum(50 * shape[:, 0], 8), np.arange(400.0, 831.0)
    curve[0] = 0
    electrons = np.interp(grid, nm, curve) * spectra.illuminant("D65", grid)  # D65 is the first illuminant of the check
    found = re.search(r"channel r would collect (\d+)%", line)
    assert found is not None
    assert int(found[1]) == pytest.approx(100 * electrons[grid > 700].sum() / electrons.sum(), abs=1)
    assert line.endswith("at all wavelengths at which the curves are not zero")
    assert stated(0.5) == []
