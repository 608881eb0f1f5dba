"""README and docs/ hold what they say: commands are complete, what is shown is what is printed, what is named is there."""

import glob
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import click
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import CameraRecipe, load_camera
from l3cli.artifacts.store import load
from l3cli.cli import COMMANDS, l3
from l3cli.io.measurement_recipe import MeasurementRecipe
from l3cli.recipes import builtin
from l3cli.recipes.toml import TELLING, Recipe
from l3cli.simulation.lab_recipe import LabRecipe
from l3cli.simulation.recipe import SceneRecipe
from l3cli.training.recipe import TrainingRecipe
from tests.helpers.paths import CONFIGS
from tests.helpers.readme import ALL, PAGES, README, commands, sessions
from tests.helpers.readme import shown as code_of

ROOT = CONFIGS.parent
RECIPES: dict[str, type[Recipe]] = {
    "cameras": CameraRecipe, "lab": LabRecipe, "scenes": SceneRecipe, "classes": TrainingRecipe,
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


def test_every_command_is_shown() -> None:
    assert {name for line in LINES for name, *_ in commands(line)} >= {*COMMANDS} - {"compare", "bench"}


@pytest.mark.parametrize("page", [README, PAGES["commands.md"]], ids=["README", "commands"])
def test_the_table_of_commands_has_all_of_them_in_order(page: str) -> None:
    listed = re.findall(r"^\| `l3 ([a-z]+)[ `]", page, re.MULTILINE)
    assert listed == list(COMMANDS)
    for first, *cells in (row.split("|")[1:] for row in page.splitlines() if row.startswith("| `l3 ")):
        _require_options(first, " ".join(cells))


def _require_options(call: str, cells: str) -> None:
    name = re.findall(r"l3 ([a-z]+)", call)[0]
    for option in re.findall(r"--[a-z][a-z-]+", call + cells):
        assert option in options_of(name), f"l3 {name} has no {option}"


def options_of(name: str) -> set[str]:
    return {word for parameter in command(name).params for word in (*parameter.opts, *parameter.secondary_opts)}


def test_every_option_named_in_passing_exists() -> None:
    known = {"--help", "--version"}.union(*(options_of(name) for name in COMMANDS))
    named = {option for code in re.findall(r"`([^`\n]+)`", ALL) for option in re.findall(r"(?<!\S)--[a-z][a-z-]+", code)}
    assert named
    assert named <= known | {"--cores", "--executor"}  # of snakemake


# ----------------------------------------------------------------------------------------------- the worked example


def shape(line: str) -> str:
    """A line without its numbers and its spacing."""
    return " ".join(re.sub(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?", "#", line).split())


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
            r"levels = 10 ": "levels = 4 ",
            r"patches = 120000": "patches = 1000",
            r"mosaics = 900": "mosaics = 8",
            r"rows = 6000": "rows = 500",
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


def test_the_worked_example_prints_what_is_shown(small: Path, l3: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(small)
    monkeypatch.setattr(builtin, "recipe_folder", lambda: small / "configs")
    session, *_ = sessions(PAGES["tutorial.md"])
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


# ------------------------------------------------------------------------------------------------- files and links


def anchors(page: str) -> set[str]:
    """The anchor that GitHub gives each heading of a page."""
    headings = re.findall(r"^#+ (.+)$", re.sub(r"^```.*?^```$", "", page, flags=re.MULTILINE | re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def cited_page(citing: Path, name: str) -> Path:
    """The page that is meant: pages link relative to themselves, all else cites from the top."""
    if (ROOT / "docs/site") in citing.parents:  # what makes pages of docs/reference
        return ROOT / "docs" / Path(name).name
    return (citing.parent / name).resolve() if citing.suffix == ".md" and (citing.parent / name).exists() else ROOT / name


def test_links_and_citations_lead_somewhere() -> None:
    front = [ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")]
    known = {page: anchors(page.read_text()) for page in (*front, *(ROOT / "docs").glob("*.md"))}
    code = [path for name in ("l3cli", "opencl", "configs", "docs") for path in (ROOT / name).rglob("*")]
    for path in (*known, *(path for path in code if path.suffix in (".py", ".cl", ".c", ".toml", ".sh"))):
        text = path.read_text(encoding="utf-8")
        for page, anchor in re.findall(r"(?<![\w/.:-])((?:docs/|\.\./)?[\w-]+\.md)#([\w-]*)", text):
            assert anchor in known.get(cited_page(path, page), set()), f"{path}: {page}#{anchor}"
        for link, anchor in re.findall(r"\]\(([^)#\s]*)(#[^)]*)?\)", text) if path in known else ():
            assert "://" in link or (path.parent / link).exists(), f"{path}: {link}"
            assert link or anchor[1:] in known[path], f"{path}: {anchor}"


def test_the_headline_figures_of_readme_are_those_of_the_benchmarks() -> None:
    table = README.partition("## Figures")[2].partition("\n## ")[0]
    rows = [row.split("|")[2:4] for row in table.splitlines() if row[:1] == "|"][2:]
    assert rows
    for ours, rival in rows:
        for figure in re.findall(r"\d+(?:\.\d+)?", re.sub(r"\(\d{4}\)", "", ours + rival)):
            assert re.search(rf"(?<![\d.]){re.escape(figure)}(?![\d.]*\d)", PAGES["benchmarks.md"]), figure


def test_files_and_make_targets_named_exist() -> None:
    named = set(re.findall(r"(?<![\w/.])((?:configs|tests|opencl|l3cli|\.ci)/[\w./-]*\w)", ALL))
    assert named
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []
    makefiles = (ROOT / "Makefile").read_text() + (CONFIGS / "pipelines/Makefile").read_text()
    targets = set(re.findall(r"^([a-z-]+):", makefiles, re.MULTILINE))
    asked = set(re.findall(r"`make ([a-z]+)`", ALL)) | set(re.findall(r"^    make ([a-z]+)", ALL, re.MULTILINE))
    assert {"demo", "test", "bench"} <= asked <= targets


# -------------------------------------------------------------------------------------------------------- recipes


def test_keys_that_identify_a_kind_of_recipe_belong_to_it_alone() -> None:
    kinds: tuple[type[Recipe], ...] = (*RECIPES.values(), MeasurementRecipe)
    assert {kind.title for kind in kinds} == set(TELLING)
    for title, keys in TELLING.items():
        for key in keys:
            assert [kind.title for kind in kinds if key in kind.__struct_fields__] == [title], key
