"""Packages import only from lower layers, and only one package uses each external library
(docs/architecture.md#layers-of-imports)."""

import ast
import functools
import graphlib
import re
from collections.abc import Iterator
from pathlib import Path

import click

from l3cli.cli import COMMANDS, l3
from l3cli.cli.terminal import with_options
from tests.helpers.paths import ROOT

PACKAGE = ROOT / "l3cli"
LAYERS = [
    {"errors", "system", "recipes"},
    {"physics"},
    {"artifacts", "spectra", "frames"},
    {"classes"},
    {"calibration", "simulation", "design", "training", "rendering", "evaluation", "report", "io", "parallel"},
    {"export"},
    {"options"},
    {"stages"},
    {"api", "cli"},
    {"video_hosts"},
    {"__main__"},
]
DOORS = {
    "click": ("cli/",),
    "pyopencl": ("rendering/opencl/",),
    "rawpy": ("io/",),
    "OpenImageIO": ("io/",),
    "tifffile": ("io/",),
    "av": ("io/",),
    "astropy": ("io/",),
    "h5py": ("artifacts/", "io/"),
    "colour": ("physics/",),
    "dask": ("parallel/cluster.py",),
    "distributed": ("parallel/cluster.py",),
    "rich": ("cli/",),
    "threadpoolctl": ("api/stages.py",),
    "jinja2": ("report/",),
    "markupsafe": ("report/",),
    "colour_demosaicing": ("evaluation/",),
    "vapoursynth": ("video_hosts/vapoursynth.py",),
    "gi": ("video_hosts/gstreamer.py", "video_hosts/plugins/"),
}


@functools.cache
def nodes(path: Path) -> list[ast.AST]:
    """Every node of a module, which is parsed once for all tests."""
    return list(ast.walk(ast.parse(path.read_text())))


@functools.cache
def imports(path: Path) -> frozenset[str]:
    modules = set()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            modules.add(node.module or "")
            if node.module in ("l3cli", "tests"):
                modules |= {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(modules)


def layer(package: str) -> int:
    return next(number for number, packages in enumerate(LAYERS) if package in packages)


def test_imports_go_down_and_never_across() -> None:
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        if parts == ("__init__",):
            continue
        for name in imports(path):
            package = name.split(".")[1] if name.startswith("l3cli.") else None
            if package is None or package in (parts[0], "__version__"):
                continue
            place, there = layer(parts[0]), layer(package)
            allowed = there < place or (there == place and place < 4)
            assert allowed, f"{path}: {parts[0]} (layer {place}) imports {name} (layer {there})"


def imported_at_start(path: Path) -> Iterator[ast.ImportFrom | ast.Import]:
    """Yield the imports of a module outside of functions."""
    inside = {id(inner) for node in nodes(path) if isinstance(node, ast.FunctionDef) for inner in ast.walk(node)}
    yield from (n for n in nodes(path) if isinstance(n, ast.ImportFrom | ast.Import) and id(n) not in inside)


def test_no_imports_in_circles() -> None:
    """Neither modules nor packages import each other in a circle, also within a layer."""
    modules: dict[str, set[str]] = {}
    packages: dict[str, set[str]] = {}
    paths = {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
             for path in PACKAGE.rglob("*.py")}  # fmt: skip
    for module, path in paths.items():
        if module == PACKAGE.name:  # it offers the API, and every module may ask it for the version
            continue
        for node in imported_at_start(path):
            of = node.module or "" if isinstance(node, ast.ImportFrom) else ""
            names = {f"{of}.{alias.name}".lstrip(".") for alias in node.names}
            imported = {name if name in paths else of for name in names} & paths.keys() - {module, PACKAGE.name}
            modules.setdefault(module, set()).update(imported)
            package = module.split(".")[1]
            packages.setdefault(package, set()).update({name.split(".")[1] for name in imported} - {package})
    for graph in (modules, packages):
        graphlib.TopologicalSorter(graph).prepare()  # raises CycleError, which names the circle


def test_libraries_enter_by_their_one_door() -> None:
    for path in PACKAGE.rglob("*.py"):
        where = path.relative_to(PACKAGE).as_posix()
        for name in imports(path):
            doors = DOORS.get(name.split(".")[0])
            assert doors is None or where.startswith(doors), f"{where} imports {name}"


def test_no_test_module_imports_another() -> None:
    """What several of them use lies in tests/helpers, which imports none of them."""
    wrong = re.compile(r"^ *(from|import) (tests(?!\.helpers\b)|(\S+\.)?(test_|conftest)).*", re.MULTILINE)
    for path in (ROOT / "tests").rglob("*.py"):
        found = wrong.search(path.read_text())
        line = found[0].strip() if found else ""
        assert not found, f'{path} has "{line}"; test modules import nothing from each other: move it to tests/helpers'


def test_class_indices_are_split_in_one_place() -> None:
    """No module but those of the stored rules divides, or takes the rest, by the number of kinds, contrasts or classes."""
    sizes = {"levels", "contrasts", "kinds", "classes_per_site"}
    for path in PACKAGE.rglob("*.py"):
        if path.name in ("class_rule.py", "plane_rules.py"):
            continue
        for node in nodes(path):
            divides = isinstance(node, ast.BinOp) and isinstance(node.op, ast.FloorDiv | ast.Mod)
            divides |= isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("divmod", "unravel_index"))
            used = {part.attr for part in ast.walk(node) if isinstance(part, ast.Attribute)} if divides else set()
            assert not used & sizes, f"{path}: {ast.unparse(node)}"


def texts(path: Path) -> Iterator[str]:
    """Every string of a module but docstrings; of an f-string the parts between its fields."""
    docstrings = {
        id(node.body[0].value)
        for node in nodes(path)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and node.body and isinstance(node.body[0], ast.Expr)
    }
    for node in nodes(path):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
            yield node.value


def test_messages_below_the_command_line_name_no_option() -> None:
    """They name parameters, ‹force›, of which cli makes options; they may name whole commands, "l3 train --merge"."""
    command, option = re.compile(r'\b(l3|dask) [^";:]*'), re.compile(r"(?<![\w(-])--[a-z]")
    for path in PACKAGE.rglob("*.py"):
        where = path.relative_to(PACKAGE).as_posix()
        if where.startswith("cli/"):
            continue
        for text in texts(path):
            assert not option.search(command.sub("", text)), f"{where}: {text}"


def test_every_parameter_that_a_message_names_is_an_option() -> None:
    context = click.Context(l3)
    commands = [command for name in COMMANDS if (command := l3.get_command(context, name))]
    options = {name for command in commands for each in command.params for name in each.opts}
    for path in PACKAGE.rglob("*.py"):
        for text in texts(path):
            assert {with_options(mark) for mark in re.findall("‹[a-z_]+›", text)} <= options, f"{path}: {text}"
