"""What must hold of the method's founding claim: an RGBW array beats a Bayer array in little light, and not in much."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from l3cli.errors import InputFileError
from l3cli.evaluation.comparison import Curve, clipping, crossings, curve_of, require_comparable, verdict
from tests.helpers.paths import CONFIGS

UNSEEN = """
illuminants = ["D65"]
luminances_cd_m2 = [1.0, 400.0]
exposure_s = [0.0333]
[[scene]]
source = "composition"
size = [160, 240]
seed = 11
"""
SCENES = """
exposure_share = [0.9]
[[scene]]
source = "dead leaves"
size = [128, 128]
count = 6
"""
CLASSES = "[classes]\npatch = 5\nlevels = 10\n[learning]\npatches = 4000\ndraws = 4\n"


@pytest.fixture(scope="module")
def evaluations(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """bayer.json and rgbw.json: evaluations in little and in much light, one exposure time."""
    import contextlib
    import io

    from l3cli.cli import run

    folder = tmp_path_factory.mktemp("light")
    for name, text in {"scenes": SCENES, "unseen": UNSEEN, "classes": CLASSES}.items():
        (folder / f"{name}.toml").write_text(text)
    for name in ("bayer", "rgbw"):
        camera = str(CONFIGS / f"cameras/{name}.toml")
        for scenes in ("scenes", "unseen"):
            file = str(folder / f"{name}.{scenes}.h5")
            assert run(["simulate", str(folder / f"{scenes}.toml"), "--camera", camera, "-o", file, "--quiet"]) == 0
        table, classes = str(folder / f"{name}.table.h5"), str(folder / "classes.toml")
        training = str(folder / f"{name}.scenes.h5")
        assert run(["train", training, "--classes", classes, "-o", table, "--quiet"]) == 0
        with contextlib.redirect_stdout(io.StringIO()) as said:
            assert run(["evaluate", table, str(folder / f"{name}.unseen.h5"), "--json", "--quiet"]) == 0
        (folder / f"{name}.json").write_text(said.getvalue())
    return folder


@pytest.mark.parametrize("figure", ["mean_delta_e", "scielab", "psnr"])
def test_without_a_filter_more_is_seen_in_little_light_only(evaluations: Path, l3: Callable, figure: str) -> None:
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


def test_the_curves_are_drawn(evaluations: Path, l3: Callable, tmp_path: Path) -> None:
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
    one = Curve("one", (1.0, 10.0, 100.0), (4.0, 2.0, 1.0))
    other = Curve("other", (1.0, 10.0, 100.0), (3.0, 3.0, 3.0))
    assert crossings(one, other, "mean_delta_e") == pytest.approx([10**0.5])
    assert crossings(one, one, "psnr") == []
    equal = Curve("equal", (1.0, 10.0, 100.0), (3.0, 2.0, 2.0))
    assert crossings(one, equal, "psnr") == pytest.approx([10.0])


def test_the_verdict_says_which_is_better_where_and_by_how_much() -> None:
    one = Curve("one", (1.0, 10.0, 100.0), (4.0, 2.0, 1.0), (0.0, 0.06, 0.5), (1 / 30,) * 3)
    other = Curve("other", (1.0, 10.0, 100.0), (3.0, 3.0, 3.25), (0.0, 0.2, 0.01), (1.0, 0.1, 0.01))
    below = "other is better than one below 3.16 cd/m², by up to 1 ΔE00; one above 3.16 cd/m², by up to 2.2 ΔE00."
    assert verdict(one, other, "mean_delta_e") == f"mean_delta_e: {below}"
    assert verdict(one, one, "psnr") == "psnr: one and one are equal at every luminance."
    assert verdict(replace(one, value=(9.0, 9.0, 29.0)), other, "psnr").endswith(
        "one is better than other at every luminance, by up to 26 dB."
    )
    assert clipping(one) == "one clips at 1/30 s from 10 cd/m² on: 50% of its pixels at 100 cd/m²."
    assert clipping(replace(one, exposure=(0.1, 0.1, 0.01))) == "one clips from 10 cd/m² on: 50% of its pixels at 100 cd/m²."
    assert clipping(other) is None  # its automatic exposure follows the light
    assert clipping(Curve("older", (1.0,), (2.0,))) is None


def test_what_was_shown_is_compared_before_anything_is_claimed(evaluations: Path, l3: Callable, tmp_path: Path) -> None:
    document = json.loads((evaluations / "bayer.json").read_text())
    for name, change in {
        "other": {"shown": {"scene": [1.0] * 8, "light": ""}},
        "older": {"shown": None},
        "odd": {"shown": 3},
    }.items():
        frames = [frame | change for frame in document["frames"]]
        (tmp_path / f"{name}.json").write_text(json.dumps(document | {"frames": frames}))
    code, out, err = l3("compare", evaluations / "bayer.json", tmp_path / "other.json", "--json")
    assert code == 0
    assert (json.loads(out)["same_scenes"], json.loads(out)["verdicts"]) == (False, [])
    assert "of other scenes or lights" in err
    code, _, err = l3("compare", evaluations / "bayer.json", tmp_path / "odd.json")
    assert (code, "frames do not say what they show" in err) == (3, True)
    code, out, err = l3("compare", evaluations / "bayer.json", tmp_path / "older.json")
    assert "not every frame says what it shows" in err
    assert "Bayer (bayer) and Bayer (older) are equal" in out  # told apart by their files


def test_what_cannot_be_compared_is_one_line(evaluations: Path, tmp_path: Path, refused: Callable) -> None:
    (tmp_path / "no.json").write_text("{")
    (tmp_path / "list.json").write_text("[1]")
    document = json.loads((evaluations / "bayer.json").read_text())
    assert "not readable" in refused(3, "compare", tmp_path / "no.json")
    assert "does not exist" in refused(3, "compare", tmp_path / "missing.json")
    assert "no evaluation" in refused(3, "compare", tmp_path / "list.json")
    (tmp_path / "none.json").write_text("{}")
    assert "none.json: no figure scielab" in refused(3, "compare", evaluations / "bayer.json", tmp_path / "none.json")
    assert 'no figure "beauty"; there are ' in refused(2, "compare", evaluations / "bayer.json", "--figure", "beauty")
    with pytest.raises(InputFileError, match="other luminances"):
        require_comparable([curve_of(document, "psnr"), Curve("b", (1.0,), (2.0,))])


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
