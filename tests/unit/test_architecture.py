"""Imports go down: never up, never across rooms; outside libraries enter by their one door (README, Architecture)."""

import ast
from pathlib import Path

from tests.helpers.paths import ROOT

PACKAGE = ROOT / "l3cli"
FLOORS = [
    {"errors", "limits", "interrupts", "config", "recipes", "files", "locks", "columns", "quantities", "units"},
    {"physics"},
    {"artifacts", "curve_table", "scene", "frame", "dark", "measurement"},
    {"classes"},
    {"calibration", "simulation", "training", "rendering", "evaluation", "report", "io", "parallel"},
    {"stages"},
    {"api", "cli"},
    {"__main__"},
]
DOORS = {
    "click": ("cli/",),
    "pyopencl": ("rendering/opencl.py", "rendering/opencl_devices.py"),
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
    "threadpoolctl": ("api.py",),
    "jinja2": ("report/",),
    "markupsafe": ("report/",),
    "colour_demosaicing": ("evaluation/",),
}


def imports(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found.add(node.module or "")
            if node.module == "l3cli":
                found |= {f"l3cli.{alias.name}" for alias in node.names}
    return found


def floor(room: str) -> int:
    return next(number for number, rooms in enumerate(FLOORS) if room in rooms)


def test_imports_go_down_and_never_across() -> None:
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        if parts == ("__init__",):
            continue
        for name in imports(path):
            room = name.split(".")[1] if name.startswith("l3cli.") else None
            if room is None or room in (parts[0], "__version__"):
                continue
            here, there = floor(parts[0]), floor(room)
            allowed = there < here or (there == here and here < 4)
            assert allowed, f"{path}: {parts[0]} (floor {here}) imports {name} (floor {there})"


def test_libraries_enter_by_their_one_door() -> None:
    for path in PACKAGE.rglob("*.py"):
        where = path.relative_to(PACKAGE).as_posix()
        for name in imports(path):
            doors = DOORS.get(name.split(".")[0])
            assert doors is None or where.startswith(doors), f"{where} imports {name}"


def test_class_indices_are_split_in_one_place() -> None:
    """No module but that of ClassRule divides, or takes the rest, by the number of kinds, contrasts or classes."""
    sizes = {"levels", "contrasts", "kinds", "classes_per_site"}
    for path in PACKAGE.rglob("*.py"):
        if path.name == "class_rule.py":
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            divides = isinstance(node, ast.BinOp) and isinstance(node.op, ast.FloorDiv | ast.Mod)
            divides |= isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("divmod", "unravel_index"))
            used = {part.attr for part in ast.walk(node) if isinstance(part, ast.Attribute)} if divides else set()
            assert not used & sizes, f"{path}: {ast.unparse(node)}"
