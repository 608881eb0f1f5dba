"""Requirements on picture quality, for colours, Bayer arrays and RGBW arrays.

A ColorChecker, which is not a training scene, has accurate colours under every training illuminant. A Bayer array is at
least as good as Menon's demosaicking. An RGBW array is better than a Bayer array in low light, but not in bright light.
"""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import open_training_set
from l3cli.errors import InputFileError
from l3cli.evaluation.comparison import Curve, clipping, crossings, curve_of, require_comparable, verdict
from l3cli.frames.frame import RawFrame
from l3cli.physics import spectra
from l3cli.physics.display import delta_e_2000, lab
from l3cli.rendering.renderer import make_renderer
from l3cli.simulation import reflectances
from l3cli.simulation.procedural import colorchecker_patches
from l3cli.training import plain_surfaces
from tests.helpers.calls import L3, Refused
from tests.helpers.paths import CONFIGS

CAMERA = CONFIGS / "cameras/fiveband.toml"
CHART = """
illuminants = ["{light}"]
exposure_share = [0.4, 0.9]
[sensor]
noise = "none"
[[scene]]
source = "colorchecker"
size = [144, 216]
"""
LIKE_A_PATCH = 0.9995  # cosine between spectra from which a measured surface may be a patch of the chart measured again
MARGIN = 6  # pixels inside a patch's rim


@pytest.fixture
def without_the_chart(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The library of reflectances without any surface that is nearly a patch of the ColorChecker."""
    whole = spectra.reflectance_library

    def unlike(wavelength: np.ndarray) -> np.ndarray:
        library, visible = whole(wavelength), (wavelength >= 420) & (wavelength <= 700)
        chart = spectra.colorchecker(wavelength)[1][:18, visible]
        cosine = (library[:, visible] @ chart.T) / np.linalg.norm(chart, axis=1)
        alike = (cosine / np.linalg.norm(library[:, visible], axis=1, keepdims=True) > LIKE_A_PATCH).any(axis=1)
        assert 3 < alike.sum() < 60
        return library[~alike]

    monkeypatch.setattr(spectra, "reflectance_library", unlike)
    reflectances.surfaces.cache_clear()
    plain_surfaces.cached_reflectances.cache_clear()
    yield
    reflectances.surfaces.cache_clear()
    plain_surfaces.cached_reflectances.cache_clear()


def chart_errors(table: Path, chart: Path) -> np.ndarray:
    """ΔE00 (frame, patch) within the patches of a chart's frames, relative to the light's white, in no gamut."""
    transforms = load(TransformTable, table)
    renderer, errors = make_renderer("opencl", transforms), []
    with open_training_set(chart) as frames:
        camera = frames.head.camera
        for frame in frames:
            outputs = renderer.outputs(RawFrame("chart", frame.raw, camera.black_level, camera.white_level))
            planes = outputs * transforms.output_unit / frame.exposure
            labs = [lab(np.moveaxis(np.asarray(xyz), 0, -1), frame.white) for xyz in (planes, frame.target)]
            error = delta_e_2000(*labs)
            inner = [
                (slice(rows.start + MARGIN, rows.stop - MARGIN), slice(cols.start + MARGIN, cols.stop - MARGIN))
                for rows, cols in colorchecker_patches(error.shape)
            ]
            errors.append([error[where].mean() for where in inner])
    return np.array(errors)


def learned_errors(light: str, classes: str, count: int, folder: Path, l3: L3) -> np.ndarray:
    scenes = (CONFIGS / "scenes/colour.toml").read_text()
    assert '["D65"]' in scenes
    assert "count = 80" in scenes
    (folder / "scenes.toml").write_text(scenes.replace('"D65"', f'"{light}"').replace("count = 80", f"count = {count}"))
    (folder / "chart.toml").write_text(CHART.format(light=light))
    (folder / "classes.toml").write_text(classes)
    for name in ("scenes", "chart"):
        arguments = ("simulate", folder / f"{name}.toml", "--camera", CAMERA, "-o", folder / f"{name}.h5", "--quiet")
        assert l3(*arguments)[0] == 0
    code, _, err = l3(
        "train", folder / "scenes.h5", "--classes", folder / "classes.toml", "-o", folder / "table.h5", "--quiet"
    )
    assert code == 0, err
    return chart_errors(folder / "table.h5", folder / "chart.h5")


def colour_classes(**changes: object) -> str:
    lines = (CONFIGS / "classes/colour.toml").read_text().splitlines()
    for key, value in changes.items():
        assert sum(line.startswith(f"{key} ") for line in lines) == 1
        lines = [f"{key} = {value}" if line.startswith(f"{key} ") else line for line in lines]
    return "\n".join(lines)


@pytest.mark.usefixtures("without_the_chart")
@pytest.mark.parametrize("light", ["D65", pytest.param("A", marks=pytest.mark.soak)])
def test_an_unseen_chart_comes_out_true(light: str, tmp_path: Path, l3: L3) -> None:
    """Small: 5×5 patches, 30 charts of surfaces, and a tenth more allowed than the full recipe below must reach."""
    errors = learned_errors(light, colour_classes(patch=5, patches=10000, draws=4), 30, tmp_path, l3)
    print(f"{light}: mean ΔE00 {errors.mean():.2f}, worst patch {errors.max():.2f}")
    assert errors.mean(axis=1).max() < 0.9, np.round(errors, 1)


@pytest.mark.slow
@pytest.mark.usefixtures("without_the_chart")
@pytest.mark.parametrize("light", ["D65", "A", "F2", "3200K"])
def test_an_unseen_chart_comes_out_true_by_the_full_recipe(light: str, tmp_path: Path, l3: L3) -> None:
    errors = learned_errors(light, colour_classes(), 80, tmp_path, l3)
    print(f"\n{light}: mean ΔE00 {errors.mean():.2f}, worst patch {errors.max():.2f}")
    assert errors.mean(axis=1).max() < 0.8, np.round(errors, 1)


def test_titanium_white_darkens_the_violet_only() -> None:
    wavelength = np.arange(380.0, 731.0, 10.0)
    for seed in range(20):
        grey = np.full(wavelength.size, 0.05 + 0.045 * seed)
        rng = np.random.default_rng(seed)
        painted = spectra.with_titanium_white(grey, wavelength, rng.uniform(0.05, 0.8), rng.uniform(5.0, 11.0))
        assert (painted <= grey + 1e-12).all()
        assert (np.diff(painted) > -1e-12).all()
        assert painted[wavelength > 500] == pytest.approx(grey[wavelength > 500], rel=0.02)
        assert painted[0] < 0.9 * grey[0]


HEAD = 'illuminants = ["D65"]\nexposure_share = [{share}]\n[sensor]\nnoise = "{noise}"\n'
LEAVES = '[[scene]]\nsource = "dead leaves"\nsize = [160, 160]\ncount = 30\n'
SEEN = ((1, 2, 4), {"BanteaySrei_01.jpg": 4, "zebra.jpg": 1, "bears.png": 1})  # faces; pictures and their shrinking
UNSEEN = ((5, 6), {"BanteaySrei_03.jpg": 4, "FruitMCC_6500.tif": 3, "woodDuck.png": 3, "elephant.png": 2})
# Least squares, as PSNR is: noise weighs what it is; nothing where there is none. The default weighs it for the eye.
CLASSES = "[classes]\npatch = 9\n[learning]\npatches = {patches}\nluminance_noise = {noise}\nchroma_noise = {noise}\n"


def scenes(data: Path, which: tuple) -> str:
    faces, pictures = which
    lines = [f'[[scene]]\nsource = "iset"\nfile = "{data}/scenes/people_small_{face}_scene.mat"\n' for face in faces]
    lines += [
        f'[[scene]]\nsource = "rgb"\nfile = "{data}/pictures/{name}"\nshrink = {shrink}\n'
        for name, shrink in pictures.items()
    ]
    return "".join(lines)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("share", "noise", "weight", "patches", "gain"), [(0.9, "none", 0, 40000, 0.0), (0.09, "all", 1, 100000, 2.0)]
)
def test_learned_is_better_than_menon(
    share: float, noise: str, weight: float, patches: int, gain: float, l3_data: Path, tmp_path: Path, l3: L3
) -> None:
    pytest.importorskip("colour_demosaicing")
    data = l3_data.resolve()
    recipes = {
        "training": HEAD.format(share=0.9, noise="all") + scenes(data, SEEN) + LEAVES,
        "unseen": HEAD.format(share=share, noise=noise) + scenes(data, UNSEEN),
    }
    for name, text in recipes.items():
        (tmp_path / f"{name}.toml").write_text(text)
        arguments = ("simulate", tmp_path / f"{name}.toml", "--camera", CONFIGS / "cameras/bayer.toml", "--quiet")
        assert l3(*arguments, "-o", tmp_path / f"{name}.h5")[0] == 0
    (tmp_path / "classes.toml").write_text(CLASSES.format(patches=patches, noise=weight))
    table = tmp_path / "table.h5"
    assert l3("train", tmp_path / "training.h5", "--classes", tmp_path / "classes.toml", "-o", table, "--quiet")[0] == 0
    document = json.loads(l3("evaluate", table, tmp_path / "unseen.h5", "--json", "--quiet")[1])
    print()
    for frame in document["frames"]:
        figures = ", ".join(f"{name} {frame[name]['psnr']:.2f} dB" for name in ("ours", "menon"))
        print(f"{frame['scene']:22} level {frame['level']:.3f}: {figures}")
    ours, menon = (document["mean"][name]["psnr"] for name in ("ours", "menon"))
    print(f"mean PSNR {ours:.2f} dB, Menon {menon:.2f} dB")
    assert ours >= menon + gain
    if noise == "all":
        assert 0.01 < sum(frame["level"] for frame in document["frames"]) / len(document["frames"]) < 0.03


UNSEEN_SCENES = """
illuminants = ["D65"]
luminances_cd_m2 = [1.0, 400.0]
exposure_s = [0.0333]
[[scene]]
source = "composition"
size = [120, 180]
seed = 11
"""
SCENES = """
exposure_share = [0.9]
[[scene]]
source = "dead leaves"
size = [96, 96]
count = 4
"""
FEW_CLASSES = "[classes]\npatch = 5\nlevels = 8\nchromas = 3\n[learning]\npatches = 2000\ndraws = 4\nfirst_draws = 0\n"


@pytest.fixture(scope="module")
def evaluations(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """bayer.json and rgbw.json: evaluations in little and in much light, one exposure time."""
    import contextlib
    import io

    from l3cli.cli import run

    folder = tmp_path_factory.mktemp("light")
    for name, text in {"scenes": SCENES, "unseen": UNSEEN_SCENES, "classes": FEW_CLASSES}.items():
        (folder / f"{name}.toml").write_text(text)
    for name in ("bayer", "rgbw"):
        camera = str(CONFIGS / f"cameras/{name}.toml")
        for scenes in ("scenes", "unseen"):
            file = str(folder / f"{name}.{scenes}.h5")
            assert run(["simulate", str(folder / f"{scenes}.toml"), "--camera", camera, "-o", file, "--quiet"]) == 0
        table, classes = str(folder / f"{name}.table.h5"), str(folder / "classes.toml")
        training = str(folder / f"{name}.scenes.h5")
        assert run(["train", training, "--classes", classes, "-o", table, "--quiet"]) == 0
        with contextlib.redirect_stdout(io.StringIO()) as words:
            assert run(["evaluate", table, str(folder / f"{name}.unseen.h5"), "--json", "--quiet"]) == 0
        (folder / f"{name}.json").write_text(words.getvalue())
    return folder


@pytest.mark.parametrize("figure", ["mean_delta_e", "scielab", "psnr"])
def test_without_a_filter_more_is_seen_in_little_light_only(evaluations: Path, l3: L3, figure: str) -> None:
    arguments = ("compare", evaluations / "bayer.json", evaluations / "rgbw.json", "--figure", figure)
    code, out, err = l3(*arguments, "--json")
    assert (code, err) == (0, "")
    document = json.loads(out)
    bayer, rgbw = (curve[figure] for curve in document["curves"])
    sign = 1 if figure == "psnr" else -1
    assert sign * (rgbw[0] - bayer[0]) > 0
    assert sign * (rgbw[1] - bayer[1]) < 0
    (crossing,) = document["crossings"]
    (luminance,) = crossing["luminances"]
    assert 1 < luminance < 400
    code, out, _ = l3(*arguments)
    assert code == 0
    by = f"by up to {abs(bayer[0] - rgbw[0]):.2g} {'dB' if figure == 'psnr' else 'ΔE00'}"
    assert f"{figure}: RGBW is better than Bayer below {luminance:.3g} cd/m², {by}; Bayer above" in out


def test_the_curves_are_drawn(evaluations: Path, l3: L3, tmp_path: Path) -> None:
    page = tmp_path / "curve.html"
    arguments = ("compare", evaluations / "bayer.json", evaluations / "rgbw.json", "--figure", "psnr", "--figure", "ssim")
    assert "ends in .html" in l3(*arguments, "-o", tmp_path / "curve.png")[2]
    assert l3(*arguments, "-o", page)[0] == 0
    first = page.read_bytes()
    assert first.count(b"<figure") == 2
    assert "psnr: RGBW is better than Bayer below" in first.decode()
    assert "exists; add --force" in l3(*arguments, "-o", page)[2]
    assert l3(*arguments, "-o", page, "--force")[0] == 0
    assert page.read_bytes() == first


def test_crossings_lie_between_points() -> None:
    clear = (0.0,) * 3, (1.0,) * 3  # nothing clips
    one = Curve("one", (1.0, 10.0, 100.0), (4.0, 2.0, 1.0), *clear)
    other = Curve("other", (1.0, 10.0, 100.0), (3.0, 3.0, 3.0), *clear)
    assert crossings(one, other, "mean_delta_e") == pytest.approx([10**0.5])
    assert crossings(one, one, "psnr") == []
    equal = Curve("equal", (1.0, 10.0, 100.0), (3.0, 2.0, 2.0), *clear)
    assert crossings(one, equal, "psnr") == pytest.approx([10.0])


def test_the_verdict_states_which_is_better_where_and_by_how_much() -> None:
    one = Curve("one", (1.0, 10.0, 100.0), (4.0, 2.0, 1.0), (0.0, 0.06, 0.5), (1 / 30,) * 3)
    other = Curve("other", (1.0, 10.0, 100.0), (3.0, 3.0, 3.25), (0.0, 0.2, 0.01), (1.0, 0.1, 0.01))
    below = "other is better than one below 3.16 cd/m², by up to 1 ΔE00; one above 3.16 cd/m², by up to 2.2 ΔE00."
    assert verdict(one, other, "mean_delta_e") == f"mean_delta_e: {below}"
    assert verdict(one, one, "psnr") == "psnr: one and one are equal at every luminance."
    assert verdict(replace(one, value=(9.0, 9.0, 29.0)), other, "psnr").endswith(
        "one is better than other at every luminance, by up to 26 dB."
    )
    assert clipping(one) == "one clips at 1/30 s from 10 cd/m² upwards: 50% of its pixels at 100 cd/m²."
    assert (
        clipping(replace(one, exposure=(0.1, 0.1, 0.01)))
        == "one clips from 10 cd/m² upwards: 50% of its pixels at 100 cd/m²."
    )
    assert clipping(other) is None  # its automatic exposure follows the light


def test_what_was_shown_is_compared_before_anything_is_claimed(evaluations: Path, l3: L3, tmp_path: Path) -> None:
    document = json.loads((evaluations / "bayer.json").read_text())
    for name, change in {
        "other": {"shown": {"scene": [1.0] * 8, "light": ""}},
        "silent": {"shown": None},
        "odd": {"shown": 3},
    }.items():
        frames = [frame | change for frame in document["frames"]]
        (tmp_path / f"{name}.json").write_text(json.dumps(document | {"frames": frames}))
    code, out, err = l3("compare", evaluations / "bayer.json", tmp_path / "other.json", "--json")
    assert code == 0
    assert (json.loads(out)["same_scenes"], json.loads(out)["verdicts"]) == (False, [])
    assert "contain different scenes or illuminants" in err
    code, _, err = l3("compare", evaluations / "bayer.json", tmp_path / "odd.json")
    assert code == 3
    code, out, err = l3("compare", evaluations / "bayer.json", tmp_path / "silent.json")
    assert "the scenes or illuminants of some frames are unknown" in err
    assert "Bayer (bayer) and Bayer (silent) are equal" in out  # told apart by their files


def test_what_cannot_be_compared_is_one_line(evaluations: Path, tmp_path: Path, refused: Refused) -> None:
    (tmp_path / "no.json").write_text("{")
    (tmp_path / "list.json").write_text("[1]")
    document = json.loads((evaluations / "bayer.json").read_text())
    assert "no.json" in refused(3, "compare", tmp_path / "no.json")
    assert "list.json" in refused(3, "compare", tmp_path / "list.json")
    (tmp_path / "none.json").write_text("{}")
    assert "none.json" in refused(3, "compare", evaluations / "bayer.json", tmp_path / "none.json")
    assert '"beauty"' in refused(2, "compare", evaluations / "bayer.json", "--figure", "beauty")
    with pytest.raises(InputFileError, match="different luminances"):
        require_comparable([curve_of(document, "psnr", Path("a.json")), Curve("b", (1.0,), (2.0,), (0.0,), (1.0,))])


def test_both_cameras_differ_in_the_array_alone() -> None:
    from dataclasses import fields

    import numpy as np

    from l3cli.artifacts.camera_recipe import load_camera

    bayer, rgbw = (load_camera(CONFIGS / f"cameras/{name}.toml") for name in ("bayer", "rgbw"))
    for field in fields(bayer):
        if field.name not in ("name", "channels", "cfa", "responsivity", "responsivity_band"):
            one, other = getattr(bayer, field.name), getattr(rgbw, field.name)
            assert np.array_equal(one, other) if isinstance(one, np.ndarray) else one == other, field.name
    assert rgbw.responsivity[:3] == pytest.approx(bayer.responsivity, rel=1e-3)
    assert (rgbw.responsivity[3] >= rgbw.responsivity[:3].max(axis=0)).all()
