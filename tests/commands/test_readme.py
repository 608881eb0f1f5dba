"""README and docs/: commands are complete, printed output is correct, and named files exist."""

import glob
import re
import shutil
from pathlib import Path

import click
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import CameraRecipe, load_camera
from l3cli.artifacts.store import load
from l3cli.cli import COMMANDS, l3
from l3cli.design.recipe import DesignRecipe
from l3cli.io.measurement_recipe import MeasurementRecipe
from l3cli.recipes import builtin
from l3cli.recipes.toml import KIND_KEYS, Recipe
from l3cli.simulation.lab import LabRecipe
from l3cli.simulation.recipe import SceneRecipe
from l3cli.training.recipe import TrainingRecipe
from tests.helpers.calls import L3
from tests.helpers.paths import CONFIGS
from tests.helpers.readme import ALL, PAGES, commands, sessions
from tests.helpers.readme import shown as code_of

ROOT = CONFIGS.parent
RECIPES: dict[str, type[Recipe]] = {
    "cameras": CameraRecipe, "lab": LabRecipe, "scenes": SceneRecipe, "classes": TrainingRecipe,
    "designs": DesignRecipe,
}  # fmt: skip
LINES = [line.removeprefix("$ ") for line in code_of(ALL) if re.match(r"(\$ )?(l3 |.*\| l3 )", line)]


def command(name: str) -> click.Command:
    subcommand = l3.get_command(click.Context(l3), name)
    assert subcommand is not None, f"l3 {name}"
    return subcommand


# ------------------------------------------------------------------------------------------------------- commands


@pytest.mark.parametrize("line", LINES)
def test_every_command_shown_is_complete(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # where a --log may lie
    calls = commands(line)
    assert calls, line
    for name, *arguments in calls:
        command(name).make_context(name, arguments)  # a click.UsageError says what is wrong or missing


def options_of(name: str) -> set[str]:
    return {word for parameter in command(name).params for word in (*parameter.opts, *parameter.secondary_opts)}


def test_every_option_named_in_passing_exists() -> None:
    known = {"--help", "--version"}.union(*(options_of(name) for name in COMMANDS))
    named = {option for code in re.findall(r"`([^`\n]+)`", ALL) for option in re.findall(r"(?<!\S)--[a-z][a-z-]+", code)}
    assert named
    assert named <= known | {"--cores", "--executor", "--list-cameras", "--tuning-file"}  # of snakemake and rpicam-hello


# ----------------------------------------------------------------------------------------------- the worked example


def shape(line: str) -> str:
    """A line without its numbers, there or not, and its spacing."""
    return " ".join(re.sub(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?|(?<!\S)–(?!\S)", "#", line).split())


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of configs/ whose recipes are the same but small."""
    folder = tmp_path_factory.mktemp("readme")
    shutil.copytree(CONFIGS, folder / "configs")
    smaller = {
        "cameras/fiveband.toml": {r"rows = \d+": "rows = 192", r"cols = \d+": "cols = 256"},
        "scenes/default.toml": {r"(?s)size = \[160, 160\]\ncount = 60.*": "size = [64, 64]\ncount = 4\n"},
        "scenes/demo_unseen.toml": {r"size = \[720, 1280\]": "size = [160, 240]"},
        "classes/default.toml": {
            r"levels = 10 ": "levels = 2 ",
            r"chromas = 9": "chromas = 2",
            r"max_cases = 12": "max_cases = 3",
            r"patches = 120000": "patches = 300",
            r"mosaics = 4700": "mosaics = 6",
            r"rows = 900 ": "rows = 300 ",
        },
    }
    for name, changes in smaller.items():
        path = folder / "configs" / name
        text = path.read_text()
        for old, new in changes.items():
            text, count = re.subn(old, new, text)
            assert count == 1, (name, old)
        path.write_text(text)
    return folder


def test_the_worked_example_prints_what_is_shown(small: Path, l3: L3, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(small)
    monkeypatch.setattr(builtin, "recipe_folder", lambda: small / "configs")
    session = [step for block in sessions(PAGES["tutorial.md"]) for step in block]
    assert [commands(line)[0][0] for line, _ in session] == [
        "lab", "calibrate", "simulate", "train", "simulate", "render", "evaluate",
    ]  # fmt: skip
    for line, shown in session:
        alone = line.replace(" --jobs 2", "")  # processes take longer to start than this takes
        words = [each for word in commands(alone)[0] for each in (sorted(glob.glob(word)) if "*" in word else [word])]
        code, out, err = l3(*words)
        assert code == 0, err
        printed = [shape(each) for each in (out + err).splitlines()]
        for each in shown:
            if each.strip() != "…":
                assert shape(each) in printed, f"{line} does not print: {each}"
    assert load(CameraModel, small / "camera.h5").channels == load_camera(small / "configs/cameras/fiveband.toml").channels
    assert (small / "rendered.png").stat().st_size > 1000


# -------------------------------------------------------------------------------------------------------- recipes


def test_keys_that_identify_a_kind_of_recipe_belong_to_it_alone() -> None:
    kinds: tuple[type[Recipe], ...] = (*RECIPES.values(), MeasurementRecipe)
    assert {kind.title for kind in kinds} == set(KIND_KEYS)
    for title, keys in KIND_KEYS.items():
        for key in keys:
            assert [kind.title for kind in kinds if key in kind.__struct_fields__] == [title], key
