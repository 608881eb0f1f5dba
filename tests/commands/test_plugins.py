"""Baselines and noise models from installed packages, as in docs/python.md, and pictures of rival pipelines."""

import json
import shutil
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import l3cli as l3_api
from l3cli.artifacts.training_set import open_training_set
from l3cli.io.images import read_image
from l3cli.io.pictures.registry import write_picture
from l3cli.physics.display import SRGB_FROM_XYZ, daylight, srgb_codes
from l3cli.simulation import sensor
from tests.helpers.calls import L3, Refused
from tests.helpers.readme import PAGES, blocks

BLOCKS = blocks(PAGES["python.md"])
PYTHON = "\n\n".join(block for block in BLOCKS if "def " in block)
PROJECT = tomllib.loads(next(block for block in BLOCKS if block.startswith("[project]")))["project"]
RECIPE = next(block for block in BLOCKS if block.startswith("[sensor]"))


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder that a package with the module of the page is installed in."""
    folder = tmp_path / "site-packages"
    about = folder / "my_l3-1.0.dist-info"
    about.mkdir(parents=True)
    (folder / "my_l3.py").write_text(PYTHON)
    groups = PROJECT["entry-points"].items()
    lines = [f"[{group}]\n" + "".join(f"{name} = {place}\n" for name, place in each.items()) for group, each in groups]
    (about / "entry_points.txt").write_text("\n".join(lines))
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n".format(**PROJECT))
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # nothing else is written where a call is refused
    yield folder
    sys.modules.pop("my_l3", None)
    sensor.noise_plugin.cache_clear()


def test_the_baseline_of_the_page_is_compared(installed: Path, pipeline: Path, l3: L3) -> None:
    code, out, _ = l3("evaluate", pipeline / "table.h5", pipeline / "unseen.h5", "--json")
    assert code == 0
    mean = json.loads(out)["mean"]
    assert mean["basic"]["psnr"] - 3 < mean["boxes"]["psnr"] < mean["malvar"]["psnr"]


def test_the_noise_model_of_the_page_is_simulated(installed: Path, pipeline: Path, l3: L3, tmp_path: Path) -> None:
    text, raws = (pipeline / "unseen.toml").read_text(), {}
    for name, recipe in {"own": text, "other": f"{text}\n{RECIPE}\n", "again": f"{text}\n{RECIPE}\n"}.items():
        (tmp_path / f"{name}.toml").write_text(recipe)
        assert l3("check", tmp_path / f"{name}.toml")[0] == 0
        files = (tmp_path / f"{name}.toml", "--camera", pipeline / "camera.h5", "-o", tmp_path / f"{name}.h5")
        assert l3("simulate", *files, "--quiet")[0] == 0
        with open_training_set(tmp_path / f"{name}.h5") as reader:
            raws[name], camera, stage = reader.frame(0).raw, reader.head.camera, reader.head.history[-1]
        assert ("# noise_model of my-l3 1.0" in stage.recipe) == (name != "own")
    assert (raws["own"] != raws["other"]).any()
    np.testing.assert_array_equal(raws["other"], raws["again"])
    dark = sensor.expose(camera, np.zeros((100, 100)), 0.0, np.random.default_rng(0), "telegraph")
    jumped = np.abs(dark - camera.black_level) / camera.gain > 25
    assert 0.007 < jumped.mean() < 0.013


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("return np.array(planes)", "return np.array(planes[:2])", "the result has the shape (2, "),
        ("return np.array(planes)", "return np.array(planes) * np.nan", "NaN or infinite values; return finite values"),
        (
            "size = 2",
            "raise RuntimeError('no array')\n    size = 2",
            "fails with RuntimeError: no array; correct or uninstall it",
        ),
        ("import numpy as np", "import nump_y", "fails with ModuleNotFoundError: No module named 'nump_y'"),
        ("signal + 30.0", "signal[1:]", "ValueError: "),
    ],
)
def test_a_function_that_fails_is_named(
    old: str, new: str, words: str, installed: Path, pipeline: Path, refused: Refused, tmp_path: Path
) -> None:
    (installed / "my_l3.py").write_text(PYTHON.replace(old, new))
    sys.dont_write_bytecode, before = True, sys.dont_write_bytecode
    name = "telegraph" if "signal" in old else "boxes"
    (tmp_path / "a.toml").write_text((pipeline / "unseen.toml").read_text() + f"\n{RECIPE}\n")
    arguments: tuple[object, ...] = ("evaluate", pipeline / "table.h5", pipeline / "unseen.h5", "--backend", "reference")
    if name == "telegraph":
        arguments = ("simulate", tmp_path / "a.toml", "--camera", pipeline / "camera.h5", "-o", tmp_path / "a.h5")
    line = refused(1, *arguments)
    sys.dont_write_bytecode = before
    assert words in line
    assert f'l3: entry point "{name}" (l3cli.' in line
    assert "of my-l3 1.0 fails" in line


def test_names_that_are_taken_or_unknown_are_refused(
    installed: Path, pipeline: Path, refused: Refused, tmp_path: Path
) -> None:
    entries = installed / "my_l3-1.0.dist-info/entry_points.txt"
    text = entries.read_text()
    for name, words in {
        "basic": "has the same name as a built-in baseline",
        "ideal": '"ideal" is reserved',
        "a/b": "may contain only letters",
    }.items():
        entries.write_text(text.replace("boxes =", f"{name} ="))
        code = 2 if name == "ideal" else 1
        assert words in refused(code, "evaluate", pipeline / "table.h5", pipeline / "unseen.h5")
    recipe, arguments = tmp_path / "a.toml", ("--camera", pipeline / "camera.h5", "-o", tmp_path / "a.h5")
    recipe.write_text((pipeline / "unseen.toml").read_text() + RECIPE.replace("telegraph", "telegraf"))
    assert '"telegraf"' in refused(2, "simulate", recipe, *arguments)
    recipe.write_text((pipeline / "unseen.toml").read_text() + f'{RECIPE}\nnoise = "shot"')
    assert "sensor.noise_model" in refused(2, "simulate", recipe, *arguments)


def test_pictures_of_a_rival_are_judged_like_ours(pipeline: Path, l3: L3, tmp_path: Path) -> None:
    """The target has no error, however bright it is shown; ideal pictures of 8 bits, cut at white, have a small one."""
    half, ideal, table = tmp_path / "half", pipeline / "unseen", pipeline / "table.h5"
    with open_training_set(pipeline / "unseen.h5") as reader:
        for number, frame in enumerate(reader):
            linear = np.moveaxis(frame.target, 0, -1) / frame.white @ (SRGB_FROM_XYZ * daylight()).T
            write_picture(half / f"{number}.png", srgb_codes(0.5 * linear, 16))
    files = ("evaluate", table, pipeline / "unseen.h5", "--rival", half, "--rival", ideal)
    code, out, err = l3(*files, "--json", "--pictures", tmp_path / "pictures", "--quiet")
    assert (code, err) == (0, "")
    document, plain = json.loads(out), json.loads(l3(*files[:3], "--json")[1])
    assert document["pipelines"] == [*plain["pipelines"], "half", "unseen"]
    assert {name: document["mean"][name] for name in plain["mean"]} == plain["mean"]
    assert document["mean"]["half"]["mean_delta_e"] < 0.01
    assert document["mean"]["half"]["psnr"] > 60
    assert 0.1 < document["mean"]["unseen"]["mean_delta_e"] < 0.6
    assert document["better"]["half"]["scielab"] == 0
    shown, wanted = (read_image(next((tmp_path / "pictures").glob(f"*_{name}.png")))[0] for name in ("half", "ideal"))
    assert np.abs(shown.astype(int) - wanted).max() <= 1
    code, out, _ = l3(*files)
    assert (code, "in which the table is better than unseen" in out) == (0, True)
    assert l3_api.evaluate(table, pipeline / "unseen.h5", rivals=[half])["mean"]["half"] == document["mean"]["half"]


def test_pictures_that_are_not_of_the_frames_are_refused(pipeline: Path, refused: Refused, tmp_path: Path) -> None:
    mine, files = tmp_path / "mine", ("evaluate", pipeline / "table.h5", pipeline / "unseen.h5", "--rival")
    shutil.copytree(pipeline / "unseen", mine)
    assert "--rival" in refused(2, *files, mine, "--rival", mine)
    shutil.copytree(mine, tmp_path / "basic")
    assert '"basic"' in refused(2, *files, tmp_path / "basic")
    first, *_ = sorted(mine.glob("*_ideal.png"))
    write_picture(first, read_image(first)[0][2:])
    assert first.name in refused(3, *files, mine)
    write_picture(mine / "99999_ideal.png", read_image(first)[0])
    assert "mine" in refused(3, *files, mine)
    assert "--rival" in refused(2, "evaluate", "--sequence", mine, "--rival", mine)
