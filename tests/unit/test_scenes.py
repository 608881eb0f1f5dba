"""Scenes from files, scenes converted from pictures, and procedural scenes."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from l3cli.errors import InputFileError
from l3cli.frames.scene import Scene, shown_alike
from l3cli.io.file_names import find_scenes
from l3cli.io.scenes.iset import read as read_iset_scene
from l3cli.io.scenes.rgb import read as read_rgb_picture
from l3cli.physics import spectra
from l3cli.physics.display import SRGB_FROM_XYZ, srgb_curve
from l3cli.simulation import light, procedural, reflectances
from l3cli.simulation.paints import PIGMENTS, WHITE_RATIO
from tests.helpers.calls import L3, Refused
from tests.helpers.paths import CONFIGS

WAVELENGTH = np.arange(400.0, 701.0, 10.0)


# --------------------------------------------------------------------------------------------------- ISET files


def save_scene(path: Path, photons: np.ndarray, coded: bool = False, **changed: object) -> Path:
    """A small ISET scene of `photons` (row, col, 31) under a sloping light, as floats or coded as 16-bit integers."""
    from scipy.io import savemat

    illuminant = np.linspace(1.0, 2.0, 31) * 1e16
    data: dict[str, object] = {"photons": photons.astype(np.float32)}
    light_data: dict[str, object] = {"photons": illuminant.astype(np.float32)}
    if coded:
        low, high = photons.min(), photons.max()
        code = np.rint((photons - low) / (high - low) * 65535).astype(np.uint16)
        data = {"photons": code, "dmin": low, "dmax": high}
        low, high = illuminant.min(), illuminant.max()
        code = np.rint((illuminant - low) / (high - low) * (2**32 - 1)).astype(np.uint32)
        light_data = {"photons": code, "min": low, "max": high}
    scene = {"spectrum": {"wave": WAVELENGTH}, "data": data, "illuminant": {"data": light_data}, **changed}
    savemat(path, {"scene": scene})
    return path


def photons(shape: tuple[int, int] = (20, 24)) -> np.ndarray:
    """Noise from slightly negative to a specular of 1.5 × white."""
    values = np.random.default_rng(0).uniform(-0.01, 1.0, (*shape, 31)) * 1e16
    values[0, 0] = 1.5 * np.linspace(1.0, 2.0, 31) * 1e16
    return values


def test_integer_storage_reads_equal_within_its_step(tmp_path: Path) -> None:
    plain = read_iset_scene(save_scene(tmp_path / "float.mat", photons()))
    coded = read_iset_scene(save_scene(tmp_path / "coded.mat", photons(), coded=True))
    assert plain.illuminant is not None
    assert coded.illuminant is not None
    assert np.allclose(plain.illuminant, coded.illuminant, rtol=1e-6)
    step = np.ptp(photons()) / 65535 / plain.illuminant
    assert (abs(plain.reflectance - coded.reflectance) <= 0.51 * step + 1e-6).all()


def test_negatives_become_zero_and_speculars_stay(tmp_path: Path) -> None:
    scene = read_iset_scene(save_scene(tmp_path / "scene.mat", photons()))
    assert scene.reflectance.min() == 0
    assert np.allclose(scene.reflectance[0, 0], 1.5, rtol=1e-5)


def test_real_scene_reads_equal_in_both_storages(l3_data: Path) -> None:
    one, other = (read_iset_scene(l3_data / f"scenes/people_small_1_scene{kind}.mat") for kind in ("", "_uint16coded"))
    assert one.reflectance.shape == (161, 150, 29)
    assert one.illuminant is not None
    step = (2.5315e16 + 3.801e14) / 65535 / one.illuminant
    assert (abs(one.reflectance - other.reflectance) <= 0.51 * step + 1e-6).all()
    assert one.reflectance.max() > 1.2


def test_a_scene_keeps_its_light(l3: L3, bayer_recipe: Path, tmp_path: Path) -> None:
    from l3cli.artifacts.training_set import open_training_set

    save_scene(tmp_path / "scene.mat", np.broadcast_to(np.linspace(0.5, 1.0, 31) * 1e16, (20, 24, 31)))  # reflectance 0.5
    recipe = tmp_path / "scenes.toml"
    recipe.write_text('illuminants = ["scene"]\nexposure_s = [0.01]\n[[scene]]\nsource = "iset"\nfile = "*.mat"\n')
    code, _, err = l3("simulate", recipe, "--camera", bayer_recipe, "-o", tmp_path / "t.h5")
    assert code == 0, err
    assert "warning" not in err
    with open_training_set(tmp_path / "t.h5") as reader:
        frame = reader.frame(0)
        assert len(reader.head.history[-1].inputs["scene"]) == 1
    assert np.allclose(frame.target, 0.5 * frame.white[:, None, None], rtol=1e-5)
    assert frame.white[1] == pytest.approx(100.0)


def test_what_a_scene_does_not_cover_is_reported_once(l3: L3, tmp_path: Path) -> None:
    save_scene(tmp_path / "scene.mat", photons((32, 32)))
    recipe = tmp_path / "scenes.toml"
    recipe.write_text('exposure_share = [0.5, 0.9]\n[[scene]]\nsource = "iset"\nfile = "scene.mat"\n')
    code, _, err = l3("simulate", recipe, "--camera", CONFIGS / "cameras/fiveband.toml", "-o", tmp_path / "t.h5")
    assert code == 0, err
    assert err.count("warning") == 1
    assert "scene" in err


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path: path.write_text("no scene"), "cannot be decoded"),
        (lambda path: path.write_bytes(b""), "cannot be decoded"),
        (lambda path: save_scene(path, photons(), illuminant={"name": "D65"}), "contains no data"),
        (lambda path: save_scene(path, photons()[..., :30]), "31 wavelengths"),
        (lambda path: save_scene(path, photons((15, 40))), "16×16"),
        (lambda path: save_scene(path, photons((20, 300))), "larger than the sensor"),
        (lambda path: save_scene(path, np.where(photons() > 5e15, np.nan, 1.0)), "not finite"),
    ],
)
def test_a_wrong_scene_file_is_one_line(
    refused: Refused, bayer_recipe: Path, tmp_path: Path, make: Callable[[Path], object], words: str
) -> None:
    make(tmp_path / "scene.mat")
    recipe = tmp_path / "scenes.toml"
    recipe.write_text('exposure_share = [0.9]\n[[scene]]\nsource = "iset"\nfile = "scene.mat"\n')
    line = refused(3, "simulate", recipe, "--camera", bayer_recipe, "-o", tmp_path / "out.h5")
    assert words in line
    assert "scene.mat" in line


def test_a_matlab_file_without_a_scene_is_refused(tmp_path: Path) -> None:
    from scipy.io import savemat

    savemat(tmp_path / "other.mat", {"picture": np.zeros((4, 4))})
    with pytest.raises(InputFileError, match="contains no scene"):
        read_iset_scene(tmp_path / "other.mat")


def test_globs_are_sorted_and_relative_to_the_recipe(tmp_path: Path) -> None:
    for name in ("b.mat", "a.mat", "c.txt"):
        (tmp_path / name).touch()
    assert [path.name for path in find_scenes("*.mat", tmp_path)] == ["a.mat", "b.mat"]
    assert find_scenes(str(tmp_path / "*.txt"), Path("elsewhere")) == [tmp_path / "c.txt"]


# ----------------------------------------------------------------------------------------------------- pictures


def test_raised_spectra_have_the_colours_of_the_picture_and_stay_reflectances() -> None:
    picture = np.random.default_rng(0).random((8, 9, 3)).astype(np.float32)
    scene = reflectances.raise_to_spectra(picture, WAVELENGTH, "random")
    assert scene.reflectance.min() >= 0
    assert scene.reflectance.max() <= 1 + 1e-6
    d65 = light.make_light("D65", {}, WAVELENGTH)
    functions = spectra.colour_matching_functions(d65.wavelength)
    xyz = scene.reflectance @ light.matching_weights(functions, d65, WAVELENGTH).T
    assert np.allclose(xyz @ SRGB_FROM_XYZ.T, picture, atol=1e-3)
    grey = reflectances.raise_to_spectra(np.full((1, 1, 3), 0.4, np.float32), WAVELENGTH, "grey")
    assert np.allclose(grey.reflectance, 0.4, atol=1e-6)


def test_a_picture_becomes_frames(l3: L3, bayer_recipe: Path, tmp_path: Path) -> None:
    from l3cli.artifacts.training_set import open_training_set
    from l3cli.io.pictures.registry import write_picture

    write_picture(tmp_path / "red.png", np.broadcast_to(np.array([200, 40, 30], np.uint8), (64, 96, 3)))
    recipe = tmp_path / "scenes.toml"
    recipe.write_text('exposure_share = [0.9]\n[[scene]]\nsource = "rgb"\nfile = "*.png"\nshrink = 2\n')
    code, _, err = l3("simulate", recipe, "--camera", bayer_recipe, "-o", tmp_path / "t.h5")
    assert code == 0, err
    with open_training_set(tmp_path / "t.h5") as reader:
        frame = reader.frame(0)
    assert frame.raw.shape == (32, 48)
    linear = SRGB_FROM_XYZ @ frame.target.mean(axis=(1, 2)) / frame.white[1]
    assert np.allclose(srgb_curve(linear) * 255, [200, 40, 30], atol=0.5)


def test_decoded_pictures_are_linear(tmp_path: Path) -> None:
    from l3cli.io.pictures.registry import write_picture

    write_picture(tmp_path / "ramp.png", np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 3, axis=2))
    linear = read_rgb_picture(tmp_path / "ramp.png")
    assert np.allclose(srgb_curve(linear[0, :, 0].astype(float)) * 255, np.arange(256), atol=0.01)
    (tmp_path / "broken.png").write_bytes((tmp_path / "ramp.png").read_bytes()[:40])
    with pytest.raises(InputFileError):
        read_rgb_picture(tmp_path / "broken.png")


# ---------------------------------------------------------------------------------------------------- procedural


def test_every_material_is_a_smooth_reflectance() -> None:
    of = reflectances.surfaces(tuple(WAVELENGTH))
    rng = np.random.default_rng(0)
    for kind in reflectances.KIND_FREQUENCIES:
        drawn = np.array([reflectances._material(rng, of, kind, 1.0) for _ in range(200)])
        assert drawn.shape == (200, WAVELENGTH.size)
        assert drawn.min() >= spectra.BLACKEST
        assert drawn.max() <= spectra.WHITEST
        assert np.median(abs(np.diff(drawn, n=2)).max(axis=1)) < 0.12, kind


def test_materials_have_the_colours_of_their_names() -> None:
    of = reflectances.surfaces(tuple(WAVELENGTH))
    rng = np.random.default_rng(0)
    mean = {
        kind: np.mean([reflectances._material(rng, of, kind, 1.0) for _ in range(200)], axis=0) for kind in ("skin", "leaf")
    }
    at = {nm: int(np.flatnonzero(nm == WAVELENGTH)[0]) for nm in (420, 450, 480, 540, 560, 580, 600, 650, 680, 700)}
    assert mean["skin"][at[560]] > mean["skin"][at[540]] < mean["skin"][at[650]]  # the W of haemoglobin
    assert 1.25 < mean["skin"][at[600]] / mean["skin"][at[580]] < 1.6  # its edge; 112 measured skins: 1.38 to 1.55
    assert 0.6 < mean["skin"][at[420]] / mean["skin"][at[480]] < 0.75  # which vessels hide; measured: 0.63 to 0.70
    assert mean["leaf"][at[560]] > 1.3 * mean["leaf"][at[450]]
    assert mean["leaf"][at[700]] > 1.3 * mean["leaf"][at[680]]  # the red edge


def test_paints_absorb_where_their_pigments_do() -> None:
    """Reflectances of pigments with four parts of white, at their absorption bands and beside them."""
    nm = np.arange(400.0, 721.0, 10.0)
    tints = {}
    for name, pigment in PIGMENTS.items():
        tints[name] = dict(zip(nm, spectra.kubelka_munk((pigment.ratio(nm) + 4 * WHITE_RATIO) / 5), strict=True))
        assert 0 < min(tints[name].values()) <= max(tints[name].values()) < 1
    assert max(tints["phthalocyanine green"][at] for at in (590, 640, 710)) < 0.3 * tints["phthalocyanine green"][510]
    assert tints["quinacridone"][450] > 1.5 * tints["quinacridone"][560] < 0.5 * tints["quinacridone"][650]
    assert tints["cadmium red"][650] > 5 * tints["cadmium red"][550]
    assert np.ptp(list(tints["carbon black"].values())) < 0.01


def test_a_tenth_of_the_materials_of_dead_leaves_are_paints() -> None:
    of = reflectances.surfaces(tuple(WAVELENGTH))
    drawn = [
        np.concatenate([reflectances.palette(np.random.default_rng(seed), of, paints) for seed in range(60)])
        for paints in (0.0, procedural.PAINTS)
    ]
    assert 0.07 < (drawn[0] != drawn[1]).any(axis=1).mean() < 0.13
    assert drawn[1].min() >= spectra.BLACKEST
    assert drawn[1].max() <= spectra.WHITEST
    leaves = [
        procedural.drawn_leaves(np.random.default_rng(0), (48, 48), WAVELENGTH, paints=paints)[0]
        for paints in (0.0, procedural.PAINTS)
    ]
    assert 0.01 < (leaves[0] != leaves[1]).any(axis=2).mean() < 0.6


DRAWINGS = {
    "leaves": lambda rng, nm: procedural.dead_leaves(rng, (48, 48), nm, 0.3),
    "composition": lambda rng, nm: procedural.composition(rng, (36, 64), nm),
    "surfaces": lambda rng, nm: procedural.surface_patches(rng, (4, 4), (48, 48), nm),
    "skin": lambda rng, nm: procedural.material_patches("skin", rng, (4, 4), (48, 48), nm),
    "munsell": lambda rng, nm: procedural.munsell((48, 60), nm),
    "picture": lambda rng, nm: reflectances.raise_to_spectra(rng.random((8, 8, 3), np.float32), nm, "picture").reflectance,
}


@pytest.mark.parametrize("camera", [(350, 710), (380, 710), (400, 700), (450, 655), (390, 830), (362, 1003)])
def test_cameras_of_any_wavelengths_are_shown_the_same_scenes(camera: tuple[float, float]) -> None:
    """What is drawn does not depend on the camera: what it sees beside DRAWN is added, and changes not a bit of the rest."""
    usual, other = reflectances.DRAWN, procedural.grid(np.array(camera, float))
    for name, draw in DRAWINGS.items():
        place, there = (Scene(name, nm, draw(np.random.default_rng(4), nm), None) for nm in (usual, other))
        assert np.array_equal(there.reflectance[..., reflectances.drawn_bands(other)], place.reflectance), name
        assert there.fingerprint == pytest.approx(place.fingerprint, abs=1e-6)
        assert np.isfinite(there.reflectance).all()
        assert there.reflectance.max() <= procedural.MAX_TIMES_WHITE, name
        known, nearly = ({"scene": of, "light": ""} for of in (place.fingerprint, place.fingerprint * (1 + 1e-6)))
        changed = place.reflectance.copy()
        changed[2, 3] += 0.2  # one pixel
        assert shown_alike(known, nearly)
        assert not shown_alike(known, {"scene": Scene(name, usual, changed, None).fingerprint, "light": ""})
        assert not shown_alike(known, known | {"light": "other"})


def test_drawn_scenes_keep_their_bytes() -> None:
    """Published figures are of these."""
    leaves = procedural.dead_leaves(np.random.default_rng(0), (48, 48), reflectances.DRAWN, 0.3)
    assert leaves.mean(dtype=float) == pytest.approx(0.19398968567445696, rel=1e-9)
    composition = procedural.composition(np.random.default_rng(0), (48, 96), reflectances.DRAWN)
    assert composition.mean(dtype=float) == pytest.approx(0.34976567075719756, rel=1e-9)


def test_saturation_zero_is_grey_and_one_changes_nothing() -> None:
    sample = np.linspace(0.1, 0.9, 31)
    assert np.allclose(spectra.with_saturation(sample, 1.0), sample)
    assert np.ptp(spectra.with_saturation(sample, 0.0)) < 1e-12


def test_no_colorchecker_among_the_training_reflectances() -> None:
    library = spectra.reflectance_library(WAVELENGTH)
    _, chart = spectra.colorchecker(WAVELENGTH)
    nearest = np.sqrt(((chart[:, None] - library[None]) ** 2).mean(axis=2)).min(axis=1)
    assert nearest.min() > 1e-3


def test_dead_leaves_are_what_the_method_asks_for() -> None:
    frames = [procedural.dead_leaves(np.random.default_rng([0, i]), (96, 96), WAVELENGTH) for i in range(12)]
    for frame in frames:
        assert frame.dtype == np.float32
        assert frame.shape == (96, 96, 31)
        assert frame.min() >= 0
        assert frame.max() <= procedural.MAX_TIMES_WHITE
    means = np.array([frame.mean() for frame in frames])
    assert 0.1 < means.mean() < 0.5
    assert max(frame.max() for frame in frames) > 1.2  # highlights
    again = procedural.dead_leaves(np.random.default_rng([0, 0]), (96, 96), WAVELENGTH)
    assert np.array_equal(again, frames[0])


def test_charts_of_any_size_hold_their_patches() -> None:
    _, reflectance = spectra.colorchecker(WAVELENGTH)
    for size in ((16, 16), (96, 144), (100, 333), (300, 90)):
        chart = procedural.colorchecker(size, WAVELENGTH)
        assert chart.shape == (*size, 31)
        covered = np.zeros(size, int)
        for (rows, cols), expected in zip(procedural.colorchecker_patches(size), reflectance, strict=True):
            covered[rows, cols] += 1
            assert np.allclose(chart[rows, cols], expected.astype(np.float32))
        assert covered.max() == 1
        assert covered.min() == 0


def test_a_composition_of_any_size_is_a_scene() -> None:
    for size in ((64, 100), (90, 160)):
        cube = procedural.composition(np.random.default_rng(0), size, WAVELENGTH)
        assert cube.shape == (*size, 31)
        assert np.isfinite(cube).all()


def test_the_grid_covers_what_the_camera_sees() -> None:
    assert procedural.grid(np.arange(390.0, 711.0, 5.0))[[0, -1]].tolist() == [390.0, 710.0]
    assert procedural.grid(np.array([450.0, 655.0]))[[0, -1]].tolist() == [390.0, 710.0]
    assert procedural.grid(np.array([362.0, 1003.0]))[[0, -1]].tolist() == [360.0, 1010.0]


@pytest.mark.parametrize(("illuminant", "value"), [(np.ones(3), 2e6), (None, 2e26)])
def test_more_light_than_can_be_is_refused(illuminant: np.ndarray | None, value: float) -> None:
    bands = np.array([400.0, 500.0, 600.0])
    Scene("sun", bands, np.full((2, 2, 3), value / 4, np.float32), illuminant)
    with pytest.raises(ValueError, match="which is implausible"):
        Scene("sun", bands, np.full((2, 2, 3), value, np.float32), illuminant)
