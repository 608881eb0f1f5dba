"""Scene files of all types and storage layouts are read correctly, and wrong files are rejected in one line."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import open_training_set
from l3cli.errors import InputFileError
from l3cli.frames.scene import Scene
from l3cli.io.scenes import bands, cube, envi
from l3cli.io.scenes.iset import read as read_iset_scene
from l3cli.physics import spectra
from l3cli.physics.display import lab
from l3cli.simulation import procedural, sources
from l3cli.simulation.procedural import draw
from l3cli.simulation.sources import framed
from tests.helpers.calls import L3, Refused
from tests.helpers.cubes import WAVELENGTH, a_cube, basis_file

RANGE = "wavelength_range_nm = [400, 700, 10]\n"


@pytest.fixture
def simulated(l3: L3, bayer_recipe: Path, tmp_path: Path) -> Callable[[str], list]:
    """The frames that a recipe (below exposure_share) gives."""

    def run(text: str) -> list:
        (tmp_path / "scenes.toml").write_text("exposure_share = [0.9]\n" + text)
        arguments = ("--camera", bayer_recipe, "-o", tmp_path / "out.h5", "--force")
        code, _, err = l3("simulate", tmp_path / "scenes.toml", *arguments)
        assert code == 0, err
        with open_training_set(tmp_path / "out.h5") as reader:
            return list(reader)

    return run


# ----------------------------------------------------------------------------------------------- ISET's storages


@pytest.mark.parametrize("illuminant", ["photons", "energy"])
@pytest.mark.parametrize("mean", [True, False])
def test_coefficients_of_a_basis_become_photons(tmp_path: Path, illuminant: str, mean: bool) -> None:
    photons, light = basis_file(tmp_path / "scene.mat", illuminant, mean)
    scene = read_iset_scene(tmp_path / "scene.mat")
    assert scene.illuminant is not None
    assert np.allclose(scene.illuminant, light, rtol=1e-6)
    assert np.allclose(scene.reflectance, photons / light, rtol=1e-5)


def test_a_scene_without_its_light_needs_one_from_the_recipe(
    simulated: Callable[[str], list], tmp_path: Path, refused: Refused, bayer_recipe: Path
) -> None:
    basis_file(tmp_path / "scene.mat")
    text = '[[scene]]\nsource = "iset"\nfile = "scene.mat"\n'
    assert len(simulated(text + 'light = "D65"\n')) == 1
    (tmp_path / "scenes.toml").write_text("exposure_share = [0.9]\n" + text)
    arguments = ("--camera", bayer_recipe, "-o", tmp_path / "other.h5")
    assert "illuminant" in refused(3, "simulate", tmp_path / "scenes.toml", *arguments)


def test_photons_next_to_wave_are_a_scene_too(tmp_path: Path) -> None:
    from scipy.io import savemat

    light = {"data": {"photons": np.full(31, 2.0)}, "spectrum": {"wave": WAVELENGTH}}
    savemat(tmp_path / "scene.mat", {"photons": a_cube(), "wave": WAVELENGTH, "illuminant": light})
    assert np.allclose(read_iset_scene(tmp_path / "scene.mat").reflectance, a_cube() / 2)


def test_a_scene_of_matlab_7_3(tmp_path: Path) -> None:
    import h5py

    with h5py.File(tmp_path / "scene.mat", "w") as root:
        root["scene/data/photons"] = a_cube().T
        root["scene/spectrum/wave"] = WAVELENGTH[:, None]
        root["scene/illuminant/data/photons"] = np.full((1, 31), 2.0)
    assert np.allclose(read_iset_scene(tmp_path / "scene.mat").reflectance, a_cube() / 2)


# --------------------------------------------------------------------------------------------------- other cubes


def test_a_folder_of_bands(simulated: Callable[[str], list], tmp_path: Path) -> None:
    import OpenImageIO as oiio

    (tmp_path / "toys").mkdir()
    stored = np.rint(a_cube() * 65535).astype(np.uint16)
    for band in range(31):
        spec = oiio.ImageSpec(24, 20, 1, "uint16")
        sink = oiio.ImageOutput.create("x.png")
        assert sink is not None
        assert sink.open(str(tmp_path / f"toys/toys_ms_{band + 1}.png"), spec)  # 10 sorts before 2 as text
        assert sink.write_image(np.ascontiguousarray(stored[..., band : band + 1]))
        sink.close()
    assert np.array_equal(bands.read(tmp_path / "toys").values, stored)
    (frame,) = simulated(f'[[scene]]\nsource = "bands"\nfile = "to*"\n{RANGE}')
    assert frame.scene == "toys"
    assert frame.raw.shape == (20, 24)


@pytest.mark.parametrize("interleave", ["bsq", "bil", "bip"])
@pytest.mark.parametrize(("code", "dtype"), [(2, ">i2"), (12, "<u2"), (4, ">f4"), (5, "<f8")])
def test_envi(tmp_path: Path, interleave: str, code: int, dtype: str) -> None:
    values = (a_cube() * 10000).astype(dtype)
    axes = {"bsq": (2, 0, 1), "bil": (0, 2, 1), "bip": (0, 1, 2)}[interleave]
    (tmp_path / "scene.img").write_bytes(b"head" + np.ascontiguousarray(values.transpose(axes)).tobytes())
    listed = ",\n ".join(f"{nm / 1000:.3f}" for nm in WAVELENGTH)
    (tmp_path / "scene.hdr").write_text(
        f"ENVI\ndescription = {{a = b}}\nsamples = 24\nlines = 20\nbands = 31\nheader offset = 4\ndata type = {code}\n"
        f"interleave = {interleave}\nbyte order = {int(dtype[0] == '>')}\nwavelength units = Micrometers\n"
        f"reflectance scale factor = 10000\nwavelength = {{{listed}}}\n"
    )
    cube = envi.read(tmp_path / "scene.hdr")
    assert np.array_equal(cube.values, values)
    assert cube.wavelength is not None
    assert np.allclose(cube.wavelength, WAVELENGTH)
    assert cube.white == 10000


def test_cubes_of_matlab_hdf5_and_numpy(tmp_path: Path) -> None:
    import h5py
    from scipy.io import savemat

    np.save(tmp_path / "a.npy", a_cube().transpose(2, 0, 1))
    savemat(tmp_path / "b.mat", {"cube": a_cube(), "wavelength": WAVELENGTH})
    with h5py.File(tmp_path / "c.mat", "w", userblock_size=512) as root:
        root["cube"] = a_cube().T
    with h5py.File(tmp_path / "d.h5", "w") as root:
        root["a/cube"], root["mask"] = a_cube(), np.zeros((2, 2, 2))
    with open(tmp_path / "c.mat", "r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file")
    assert np.array_equal(cube.read(tmp_path / "a.npy", None, "band row col").values, a_cube())
    ordered = cube.read(tmp_path / "b.mat", None, "row col band")
    assert np.array_equal(ordered.values, a_cube())
    assert ordered.wavelength is not None
    assert np.array_equal(ordered.wavelength, WAVELENGTH)
    assert np.array_equal(cube.read(tmp_path / "c.mat", "cube", "row col band").values, a_cube())
    assert np.array_equal(cube.read(tmp_path / "d.h5", "a/cube", "row col band").values, a_cube())
    with pytest.raises(InputFileError, match="a/cube, mask"):
        cube.read(tmp_path / "d.h5", None, "row col band")


def test_exr_channels_and_tiff_pages(tmp_path: Path) -> None:
    import tifffile

    from l3cli.io.pictures.registry import write_picture

    shuffled = np.random.default_rng(0).permutation(31)
    write_picture(tmp_path / "a.exr", a_cube()[..., shuffled], tuple(f"S0.{WAVELENGTH[i]:.0f},5nm" for i in shuffled))
    scene = bands.read(tmp_path / "a.exr")
    assert np.array_equal(scene.values, a_cube())
    assert scene.wavelength is not None
    assert np.allclose(scene.wavelength, WAVELENGTH + 0.5)
    tifffile.imwrite(tmp_path / "b.tif", a_cube().transpose(2, 0, 1), photometric="minisblack")
    assert np.array_equal(bands.read(tmp_path / "b.tif").values, a_cube())


def test_radiance_divided_by_its_light_is_reflectance(simulated: Callable[[str], list], tmp_path: Path) -> None:
    light = spectra.illuminant("A", WAVELENGTH) / spectra.photons_from_energy(WAVELENGTH, np.ones(31))
    np.save(
        tmp_path / "flat.npy", np.broadcast_to(0.5 * light / light.max(), (20, 24, 31)) * np.linspace(0.5, 1, 24)[:, None]
    )
    text = f'[[scene]]\nsource = "cube"\nfile = "flat.npy"\nholds = "radiance"\n{RANGE}'
    (relit,) = simulated(f'illuminants = ["D50"]\n{text}light = "A"\n')
    grey = relit.target[:, 0, -1] / relit.white
    assert np.ptp(grey) < 2e-3 * grey.mean()
    (frame,) = simulated(f'illuminants = ["scene"]\n{text}')
    colour = frame.target[:, 0, -1] / frame.target[1, 0, -1]
    expected = spectra.xyz_weights(WAVELENGTH) @ spectra.illuminant("A", WAVELENGTH)
    assert np.allclose(colour, expected / expected[1], rtol=1e-3)


SCENES = {
    "people_small_?_scene*.mat": 'source = "iset"\n',
    "multispectral_day*.mat": 'source = "cube"\nwavelengths_nm = [405, 435, 450, 470, 505, 525, 570, 590, 630, 645, 660, '
    "700, 780, 850, 870, 890, 910, 940, 970]\n",
    "flea3_7band/*.mat": 'source = "cube"\nholds = "photons"\nwavelength_range_nm = [400, 700, 50]\n',
}


@pytest.mark.parametrize(("pattern", "count"), list(zip(SCENES, (6, 3, 1), strict=True)))
def test_every_real_scene_opens(l3: L3, l3_data: Path, tmp_path: Path, pattern: str, count: int) -> None:
    lights = 'illuminants = ["scene"]\n' if "photons" in SCENES[pattern] else ""
    (tmp_path / "scenes.toml").write_text(
        f'exposure_share = [0.9]\n{lights}[[scene]]\nfile = "{l3_data / "scenes" / pattern}"\n{SCENES[pattern]}'
    )
    arguments = ("--camera", "configs/cameras/fiveband.toml", "-o", tmp_path / "t.h5")
    code, _, err = l3("simulate", tmp_path / "scenes.toml", *arguments)
    assert code == 0, err
    with open_training_set(tmp_path / "t.h5") as reader:
        assert len(reader) == count
        assert all(frame.target[1].mean() > 0.02 * frame.white[1] for frame in reader)


# ------------------------------------------------------------------------------------------------------- charts


def a_drawing(source: sources.Synthetic, camera: CameraModel) -> Scene:
    return draw(sources.WantedScene(source), 0, camera.wavelength)  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", [kind for kind in sources.Synthetic.__subclasses__() if kind is not sources.Random])
def test_every_chart_of_any_size_is_a_scene(bayer: CameraModel, kind: type) -> None:
    for size in ((16, 16), (50, 97)):
        cube = a_drawing(kind(size=size), bayer).reflectance
        assert cube.shape[:2] == size
        assert 0 <= cube.min() < cube.max() <= 1.001


def test_a_grey_ramp_spans_its_octaves(bayer: CameraModel) -> None:
    ramp = a_drawing(sources.GreyRamp(size=(16, 600)), bayer).reflectance[..., 0]
    assert ramp[0, 0] == pytest.approx(2.0**-14)
    assert ramp[-1, 0] == pytest.approx(2.0**-14)
    assert ramp[0, -1] == ramp[-1, -1] == 1
    assert np.allclose(np.diff(np.log2(ramp[0])), 14 / 599, rtol=1e-2)
    assert len(np.unique(ramp[-1])) == 29


def test_a_slanted_edge_lies_where_it_should(bayer: CameraModel) -> None:
    edge = a_drawing(sources.SlantedEdge(size=(64, 64), angle_deg=5.0, dark=0.1, bright=0.6), bayer).reflectance[..., 0]
    position = ((0.6 - edge) / 0.5).sum(axis=1)  # pixels from the left
    rows = np.arange(64) + 0.5 - 32
    assert np.allclose(position, 32 - np.tan(np.radians(5)) * rows, atol=0.1)


def test_the_frequencies_of_a_grating_double(bayer: CameraModel) -> None:
    chart = a_drawing(sources.Frequencies(size=(16, 6 * 128)), bayer).reflectance[0, :, 0]
    for order in range(6):
        power = abs(np.fft.rfft(chart[order * 128 : (order + 1) * 128] - 0.45))
        assert power.argmax() == 2 << order


def test_munsell_colours_are_evenly_spread_and_real(bayer: CameraModel) -> None:
    cube = procedural.munsell((16 * 8, 20 * 8), WAVELENGTH)
    d65 = spectra.illuminant("D65", WAVELENGTH)
    xyz = cube[4::8, 4::8] @ (spectra.xyz_weights(WAVELENGTH) * d65).T / (spectra.xyz_weights(WAVELENGTH)[1] @ d65)
    lightness = lab(xyz, spectra.white_point("D65"))[..., 0]
    assert np.allclose(lightness, np.repeat((30, 50, 70, 85), 4)[:, None], atol=0.6)


# ------------------------------------------------------------------------------------------------------ framing


def test_crop_flip_and_turn(bayer: CameraModel) -> None:
    scene = Scene("x", WAVELENGTH, a_cube(), None)
    got = framed(scene.reflectance, sources.Framing(crop=(2, 3, 10, 12), flip="cols", rotate=90), bayer)
    assert np.array_equal(got, np.rot90(a_cube()[2:12, 3:15][:, ::-1]))
    with pytest.raises(ValueError, match="beyond"):
        framed(scene.reflectance, sources.Framing(crop=(12, 0, 10, 10)), bayer)


@pytest.mark.parametrize("scale", [0.25, 0.7, 1.0, 2.5])
def test_scaling_keeps_straight_lines_and_means(bayer: CameraModel, scale: float) -> None:
    ramp = np.broadcast_to(np.arange(80.0, dtype=np.float32)[:, None] + 0.5, (60, 80, 1))
    got = framed(ramp, sources.Framing(scale=scale), bayer)[..., 0]
    assert got.shape == (round(60 * scale), round(80 * scale))
    inner = slice(3, -3)
    assert np.allclose(got[:, inner], (np.arange(got.shape[1]) + 0.5)[inner] / scale, atol=1e-3)
    assert got.mean() == pytest.approx(40.0, rel=1e-3)


def test_a_field_of_view_sets_the_size_and_the_sensor_cuts_it(bayer: CameraModel) -> None:
    scene = Scene("x", np.array([550.0]), np.random.default_rng(0).random((30, 40, 1), dtype=np.float32), None)
    degrees = 2 * np.degrees(np.arctan(120 * bayer.pixel_pitch / bayer.optics.focal_length / 2))
    assert framed(scene.reflectance, sources.Framing(field_of_view_deg=degrees), bayer).shape == (90, 120, 1)
    whole = framed(scene.reflectance, sources.Framing(scale=8.0), bayer)
    assert whole.shape == (192, 256, 1)
    mirrored = framed(scene.reflectance, sources.Framing(scale=8.0, flip="cols"), bayer)
    assert np.allclose(mirrored, whole[:, ::-1], atol=1e-5)  # what is cut is the same on both sides
    wide = framed(scene.reflectance, sources.Framing(scale=4.0), bayer)
    assert wide.mean() == pytest.approx(scene.reflectance.mean(), rel=1e-2)


# ---------------------------------------------------------------------------------------------------- bad input


def write(path: Path, cube: np.ndarray) -> str:
    np.save(path / "cube.npy", cube)
    return '[[scene]]\nsource = "cube"\nfile = "cube.npy"\n'


SPECTRAL = 'illuminants = ["scene"]\ntarget.outputs = "reflectance 31"\n'
BAD = {
    "no wavelengths": (lambda p: write(p, a_cube()), 3, "contains no wavelengths"),
    "out of order": (lambda p: write(p, a_cube()[..., :3]) + "wavelengths_nm = [500, 400, 600]\n", 2, "neither increases"),
    "band first": (lambda p: write(p, a_cube().transpose(2, 0, 1)) + RANGE, 3, "along the row axis"),
    "NaN": (lambda p: write(p, np.where(a_cube() > 0.9, np.nan, a_cube())) + RANGE, 3, "not finite"),
    "Inf": (lambda p: write(p, np.where(a_cube() > 0.9, np.inf, a_cube())) + RANGE, 3, "not finite"),
    "too small": (lambda p: write(p, a_cube((8, 24))) + RANGE, 3, "at least 16×16"),
    "too large": (lambda p: write(p, a_cube((20, 300))) + RANGE, 3, "larger than the sensor"),
    "two axes": (lambda p: write(p, a_cube()[..., 0]) + RANGE, 3, "three axes"),
    "no relighting": (lambda p: write(p, a_cube()) + RANGE + 'holds = "radiance"\n', 2, "under an unknown illuminant"),
    "no reflectance": (
        lambda p: SPECTRAL + write(p, a_cube()) + RANGE + 'holds = "radiance"\n', 2, "its reflectances are unknown"
    ),
    "illuminant of its own": (
        lambda p: write(p, a_cube()) + RANGE + 'holds = "radiance"\nlight = "scene"\n', 2, '"scene" is unknown'
    ),
    "wrong axes": (lambda p: write(p, a_cube()) + RANGE + 'axes = "row col"\n', 2, "axes"),
    "crop": (lambda p: write(p, a_cube()) + RANGE + "crop = [0, 0, 30, 30]\n", 3, "beyond"),
    "crop drawn": (lambda p: '[[scene]]\nsource = "munsell"\nsize = [32, 32]\ncrop = [0, 0, 40, 20]\n', 2, "beyond"),
    "scale": (lambda p: write(p, a_cube()) + RANGE + "scale = -1.0\n", 2, "scale is -1.0; use more than 0"),
    "empty folder": (lambda p: (p / "d").mkdir() or f'[[scene]]\nsource = "bands"\nfile = "d"\n{RANGE}', 3, "no pictures"),
    "no ENVI": (lambda p: (p / "a.hdr").write_text("x") and '[[scene]]\nsource = "envi"\nfile = "a.hdr"\n', 3, "ENVI"),
    "broken .npy": (lambda p: write(p, a_cube())[: (p / "cube.npy").write_bytes(b"x") * 99] + RANGE, 3, "cube.npy"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_a_wrong_cube_is_one_line(refused: Refused, bayer_recipe: Path, tmp_path: Path, case: str) -> None:
    make, code, words = BAD[case]
    (tmp_path / "scenes.toml").write_text("exposure_share = [0.9]\n" + make(tmp_path))
    line = refused(code, "simulate", tmp_path / "scenes.toml", "--camera", bayer_recipe, "-o", tmp_path / "out.h5")
    assert words in line
