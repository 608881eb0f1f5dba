"""The stage of `l3 check`, which finds the faults of recipes and their lines.

This module also makes the JSON schema of each kind of recipe. The checks of design recipes and of scene files stand here
because they need several packages that do not import each other.
"""

import contextlib
import itertools
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import CameraRecipe, PhaseRecipe, camera_recipe_faults, load_camera
from l3cli.artifacts.recipe_source import Meaning, RecipeSource, key_in, keys_of
from l3cli.design.recipe import DesignRecipe, design_faults, filter_curves, level_name, pixel_of
from l3cli.errors import InputFileError, L3Error, RecipeError, suggestion
from l3cli.io.file_names import find_scenes
from l3cli.io.measurement_check import measurement_faults, measurement_lines, measurement_meaning
from l3cli.io.measurement_recipe import CorrectionRecipe, MeasurementRecipe
from l3cli.recipes.builtin import known_benchmarks, known_recipes
from l3cli.recipes.faults import LISTED_FAULTS, Fault, about_others, fault, typed
from l3cli.recipes.key_lines import key_lines, line_of
from l3cli.recipes.schema import schema_of
from l3cli.recipes.toml import KIND_KEYS, KeyPath, Recipe, parse_toml, read_text
from l3cli.simulation.frame import SimulationRun
from l3cli.simulation.lab import LabRecipe, lab_recipe_faults
from l3cli.simulation.light import Filters, named_beyond_known
from l3cli.simulation.recipe import SceneRecipe, curve_faults, scene_faults, shots
from l3cli.simulation.sources import wanted_scenes
from l3cli.simulation.summary import camera_lines, camera_meaning, lab_lines, lab_meaning, scene_lines
from l3cli.stages.simulation.preparation import prepare, refusals, scene_files, size_of, unknown_of
from l3cli.training.recipe import TrainingRecipe, class_recipe_faults
from l3cli.training.summary import class_lines, class_meaning


def files_named(path: Path, content: Mapping[str, Any]) -> tuple[Path, ...]:
    """Return every existing file that a recipe names: directly, with a pattern, or within a mixture of illuminants.

    Parameters
    ----------
    path : Path
        The recipe. The names in it are relative to its folder.
    content : mapping
        The content of the recipe.
    """
    found: list[Path] = []
    for _, value in keys_of(content):
        for name in dict.fromkeys([value, *value.split()]) if isinstance(value, str) else []:
            single = path.parent / name
            found += [single] if os.path.isfile(single) else []
            if any(letter in name for letter in "*?["):
                with contextlib.suppress(InputFileError):
                    found += find_scenes(name, path.parent)
    return tuple(dict.fromkeys(found))


def design_recipe_faults(recipe: DesignRecipe, source: RecipeSource) -> Iterator[Fault]:
    """Yield the faults of a design recipe; if it has none, those of the spectra that it names."""
    wrong = list(design_faults(recipe))
    yield from wrong
    if not wrong:
        yield from source.attempt(None, _design_curves, recipe, source)


def _design_curves(recipe: DesignRecipe, source: RecipeSource) -> Any:
    camera = pixel_of(recipe.pixel, source.path.parent)
    return filter_curves(recipe, camera, camera.wavelength, source.path.parent)


def design_meaning(recipe: DesignRecipe, source: RecipeSource) -> Meaning:
    """Return the peak quantum efficiency of each filter, and the illuminants and exposures."""
    curves = _design_curves(recipe, source)
    camera = pixel_of(recipe.pixel, source.path.parent)
    filters = Filters.of(dict(zip(recipe.filters, curves, strict=True)), camera.wavelength)
    return {
        "filters": dict(zip(recipe.filters, curves.max(axis=1).tolist(), strict=True)),
        "levels": list(map(level_name, recipe.level)),
        "warnings": named_beyond_known((level.illuminant for level in recipe.level), filters),
    }, []


def design_lines(figures: dict[str, Any], width: int | None) -> list[str]:
    """Return the figures of a design recipe as lines."""
    filters = ", ".join(f"{name} {100 * peak:.0f} %" for name, peak in figures["filters"].items())
    return [f"filters, peak quantum efficiency: {filters}", f"levels: {'; '.join(figures['levels'])}"]


def scene_recipe_faults(recipe: SceneRecipe, source: RecipeSource) -> Iterator[Fault]:
    """Yield the faults of a scene recipe and of the files that it names, for the camera of `source` if it has one."""
    yield from scene_faults(recipe, source.camera)
    yield from curve_faults(recipe, source)
    for number, scene in enumerate(recipe.scene):
        yield from source.attempt(("scene", number, "file"), scene_files, scene, source.path)
    for number, pair in enumerate(recipe.pair):
        for side, name in (("raw", pair.raw), ("picture", pair.picture)):
            if not os.path.isfile(source.file(name)):
                message = f"{source.file(name)} does not exist; name a file relative to the recipe"
                yield fault(message, f"pair.{number}.{side}")


def scene_meaning(recipe: SceneRecipe, source: RecipeSource) -> Meaning:
    """Return how many frames a scene recipe makes and, with a camera, their size and the files that do not fit on it."""
    run = None
    if source.camera is None:
        files = [scene_files(scene, source.path) for scene in recipe.scene]
    else:
        run, files = prepare(recipe, source.path, source.camera, 0)
    wanted = list(shots(recipe, files)) if recipe.scene else []
    document: dict[str, Any] = {
        "scenes": len(wanted),
        "clips": sum(scene.source.motion is not None for scene, _ in wanted),
        "illuminants": recipe.illuminants,
        "luminances_cd_m2": recipe.luminances(),
        "exposures": dict([recipe.exposures()]) if recipe.scene else {},
        "pairs": len(recipe.pair),
        "frames": sum(len(each) for _, each in wanted) + len(recipe.pair),
    }
    if run is None:
        return document, []
    bad = [
        Fault(str(error), (("scene", number, "file"),))
        for number, errors in enumerate(refusals(run, files))
        for error in errors.values()
    ]
    assert source.camera is not None
    whole = document | _sizes(recipe, run, files) | {"warnings": unknown_of(run, source.camera)}
    return (document, bad) if bad else (whole, [])


def _sizes(recipe: SceneRecipe, run: SimulationRun, files: list[list[Path]]) -> dict[str, Any]:
    """Return the size of the largest frame (rows, cols), and the bytes of that frame and of all frames."""
    sizes = []
    for scene, paths in zip(recipe.scene, files, strict=True):
        each = len(recipe.illuminants) * len(recipe.luminances()) * len(recipe.exposures()[1])
        each *= scene.motion.frames if scene.motion else 1
        sizes += [(size_of(wanted, run), each) for wanted in wanted_scenes(scene, paths)]
    if not sizes:
        return {"camera": run.camera.name}
    a_pixel = run.frame_bytes / (run.camera.rows * run.camera.cols)
    pixels = [rows * cols for (rows, cols), _ in sizes]
    return {
        "camera": run.camera.name,
        "largest": list(sizes[int(np.argmax(pixels))][0]),
        "largest_bytes": int(max(pixels) * a_pixel),
        "bytes": int(sum(number * each for number, (_, each) in zip(pixels, sizes, strict=True)) * a_pixel),
    }


class Kind(NamedTuple):
    """A kind of recipe that `l3 check` knows."""

    name: str
    recipes: tuple[type[Recipe], ...]  # the structure of a whole recipe, and of one with `base`
    folder: str | None  # folder of the recipes that come with l3, within configs/

    @property
    def title(self) -> str:
        return self.recipes[0].title

    def structure(self, content: Mapping[str, Any]) -> type[Recipe]:
        """Return the structure that a file of this kind with the given content must have."""
        return self.recipes[-1] if "base" in content else self.recipes[0]


CAMERA = "camera"
# keys that show the kind of a recipe with `base`
BASED = {"a camera recipe": ("base", "phase"), "a measurement file": ("dark", "white")}
KINDS = {
    kind.name: kind
    for kind in (
        Kind(CAMERA, (CameraRecipe, PhaseRecipe), "cameras"),
        Kind("lab", (LabRecipe,), "lab"),
        Kind("scenes", (SceneRecipe,), "scenes"),
        Kind("classes", (TrainingRecipe,), "classes"),
        Kind("design", (DesignRecipe,), "designs"),
        Kind("measurements", (MeasurementRecipe, CorrectionRecipe), None),
    )
}


def kind_of(content: Mapping[str, Any]) -> Kind | None:
    """Return the kind of recipe that a file's keys and tables suggest, or None if two kinds fit equally well.

    Keys that only one kind has count first; among equals, the number of known keys with a fitting value decides.
    """
    ranked = sorted(KINDS.values(), key=lambda kind: _likeness(content, kind), reverse=True)
    best, second = (_likeness(content, kind) for kind in ranked[:2])
    return ranked[0] if best > second else None


def _likeness(content: Mapping[str, Any], kind: Kind) -> tuple[int, int]:
    based = BASED.get(kind.title, ()) if "base" in content or kind.name == CAMERA else ()
    matching = sum(key in content for key in (*KIND_KEYS[kind.title], *based))
    fields = {field.encode_name: field for field in msgspec.structs.fields(kind.structure(content))}
    return matching, sum(_fits(fields[key], value) for key, value in content.items() if key in fields)


def _fits(field: msgspec.structs.FieldInfo, value: Any) -> bool:
    """Return whether a value has the form of a field (table, list or value), whatever faults it has inside."""
    try:
        msgspec.convert(value, field.type)
    except msgspec.ValidationError as error:
        return " - at " in str(error) or "missing" in str(error) or "unknown" in str(error)
    return True


def names() -> dict[str, list[tuple[Kind, Path]]]:
    """Return the recipes that come with l3: by name, every kind and file with that name."""
    known: dict[str, list[tuple[Kind, Path]]] = {}
    for kind in KINDS.values():
        for name, path in (known_recipes(kind.folder) if kind.folder else {}).items():
            known.setdefault(name, []).append((kind, path))
    return known


def schema(kind: str) -> dict[str, Any]:
    """Return the JSON schema of a kind of recipe."""
    return schema_of(KINDS[kind].recipes, KINDS[kind].title)


class Judge(NamedTuple):
    """How recipes of a kind are checked and explained."""

    faults: Callable[[Any, RecipeSource], Iterator[Fault]]
    meaning: Callable[[Any, RecipeSource], Meaning]
    lines: Callable[[dict[str, Any], int | None], list[str]]  # turns a meaning into text; the second argument is the width


JUDGES = {
    CAMERA: Judge(camera_recipe_faults, camera_meaning, camera_lines),
    "lab": Judge(lab_recipe_faults, lab_meaning, lab_lines),
    "scenes": Judge(scene_recipe_faults, scene_meaning, scene_lines),
    "classes": Judge(class_recipe_faults, class_meaning, class_lines),
    "design": Judge(design_recipe_faults, design_meaning, design_lines),
    "measurements": Judge(measurement_faults, measurement_meaning, measurement_lines),
}
INDENT = "  "
# the part of a message that differs between otherwise equal faults: an entry's number, or the name of a missing file
ENTRY = re.compile(r"\[\d+\]|^.*(?= does not exist)")
FEW, NAMED = 3, 8  # up to FEW equal faults are listed one by one; of more, NAMED line numbers follow the first
SYNTAX = re.compile(r"\(at line (\d+), column \d+\)")  # the place that the TOML parser names


class Finding(NamedTuple):
    """A fault, with its line and key in the file."""

    line: int
    key: str
    message: str


@dataclass(frozen=True)
class Judgement:
    """The faults of a file or, if it has none, its meaning."""

    path: Path
    kind: str | None = None  # a key of KINDS; None if unknown
    findings: tuple[Finding, ...] = ()  # at most LISTED_FAULTS
    more: int = 0  # further faults that were found but not listed
    meaning: dict[str, Any] = field(default_factory=dict)
    files: tuple[Path, ...] = ()  # files that the recipe names

    def document(self) -> dict[str, Any]:
        """Return the judgement as `l3 check --json` prints it."""
        found = [finding._asdict() for finding in self.findings]
        return {
            "file": str(self.path),
            "kind": self.kind,
            "faults": found,
            "more_faults": self.more,
            "meaning": self.meaning,
        }


def check(given: Sequence[str]) -> list[Judgement]:
    """Check recipes.

    Cameras are checked first, so that the other recipes can be checked for a camera: the one in their own folder if there
    is one, otherwise the first.

    Parameters
    ----------
    given : sequence of str
        Paths, folders, or names of recipes that come with l3.

    Raises
    ------
    RecipeError, InputFileError
        If a file, folder or name does not exist.
    """
    meant = list(dict.fromkeys(each for name in given for each in recipes_of(name)))
    cameras: dict[Path, CameraModel] = {}
    judged: dict[Path, Judgement] = {}
    for path in sorted(meant, key=lambda path: not _is_camera(path)) if len(meant) > 1 else meant:
        neighbours = [each for each in cameras if each.parent == path.parent]
        judged[path] = judge(path, cameras[(neighbours or [*cameras])[0]] if cameras else None)
        if judged[path].kind == CAMERA and not judged[path].findings:
            cameras[path] = load_camera(path)
    return [judged[path] for path in meant]


def recipes_of(name: str) -> list[Path]:
    """Return the files that a path, a folder of recipes, or the name of a recipe stands for.

    Recipes of several kinds may have the same name; then all of them are returned.
    """
    path = Path(name)
    if path.exists() and not path.is_dir():  # whatever it is; the reader refuses devices and the like
        return [path]
    if name in names():
        return [file for _, file in names()[name]]
    folder = known_benchmarks().get(name, path)
    if folder.is_dir():
        files = sorted(folder.glob("*.toml"), key=lambda each: (each.name != "camera.toml", each.name))
        if not files:
            raise InputFileError(f"{folder} contains no recipes (*.toml); name a file or a folder of recipes")
        return files
    if os.sep in name or path.suffix:
        raise InputFileError(f"{name} does not exist; give a recipe or a measurement file (TOML)")
    raise RecipeError(f'no file or recipe is called "{name}"; {suggestion(name, [*names(), *known_benchmarks()])}')


def _is_camera(path: Path) -> bool:
    try:
        kind = kind_of(parse_toml(read_text(path), str(path)))
    except L3Error:
        return False
    return kind is not None and kind.name == CAMERA


def judge(path: Path, camera: CameraModel | None = None) -> Judgement:
    """Check one file, for a camera if one is given."""
    try:
        text = read_text(path, "a recipe or a measurement file")
        content = parse_toml(text, str(path))
    except L3Error as error:
        message = str(error).removeprefix(f"{path} ").removeprefix(f"{path}: ")
        at = SYNTAX.search(message)
        return Judgement(path, None, (Finding(int(at[1]) if at else 1, "", message),))
    kind = next((kind for found in names().values() for kind, file in found if file == path), None) or kind_of(content)
    if kind is None:
        kinds = ", ".join(each.title for each in KINDS.values())
        message = f"the keys do not show whether this is {kinds}; add a key that only one of them has, such as responsivity"
        return Judgement(path, None, (Finding(1, "", message),))
    meaning, faults = _judged(kind, RecipeSource(path, content, camera))
    findings = _findings([each for each in faults if each.message][:LISTED_FAULTS], text)
    more = len(faults) - len(findings)
    return Judgement(path, kind.name, findings, more, {} if faults else meaning, files_named(path, content))


def _judged(kind: Kind, source: RecipeSource) -> tuple[dict[str, Any], list[Fault]]:
    """Return the meaning and the faults of a recipe.

    Faults of type are found first, then faults of the keys; only a recipe without these is interpreted, which may show more.
    """
    recipe, faults = typed(dict(source.content), kind.structure(source.content))
    if recipe is not None:
        others = about_others(JUDGES[kind.name].faults(recipe, source), faults)
        faults += itertools.islice(
            others, max(LISTED_FAULTS + 1 - len(faults), 0)
        )  # to look for more would take long and help nobody
    meaning: dict[str, Any] = {}
    if not faults:
        try:
            meaning, faults = JUDGES[kind.name].meaning(recipe, source)
        except (L3Error, OSError) as error:
            message = source.plain(error)
            faults = [Fault(message, (key_in(message, source.content),))]
    return meaning, faults


def _findings(faults: Iterable[Fault], text: str) -> tuple[Finding, ...]:
    """Return the faults with their lines, in the order of the file."""
    lines = key_lines(text)
    found = []
    for message, keys in faults:
        key = next((key for key in keys if key in lines), keys[0] if keys else ())  # prefer a key that the file has
        found.append(Finding(line_of(key, lines), _written(key), message))
    return tuple(sorted(found, key=lambda finding: finding.line))


def _written(key: KeyPath) -> str:
    """Return a key as messages write it, with entries of lists counted from 1."""
    return "".join(f"[{part + 1}]" if isinstance(part, int) else f".{part}" for part in key).lstrip(".")


# --------------------------------------------------------------------------------------------------------- text


def as_text(judgement: Judgement, width: int | None = None) -> list[str]:
    """Return a judgement as lines of text.

    Each fault has a line of the form `file:line: message`, which editors understand. Without faults, the lines say what
    the recipe means, with tables at most `width` characters wide.
    """
    if judgement.findings:
        lines = [f"{judgement.path}:{line}: {message}" for line, message in folded(judgement.findings)]
        more = f"{f'{judgement.more} ' * (judgement.more > 1)}more"
        return [*lines, f"{judgement.path}: and {more}"] if judgement.more else lines
    assert judgement.kind is not None
    inside = None if width is None else width - len(INDENT)
    lines = JUDGES[judgement.kind].lines(judgement.meaning, inside) if judgement.meaning else []
    lines += [f"warning: {text}" for text in judgement.meaning.get("warnings", [])]
    return [f"{judgement.path}: {KINDS[judgement.kind].title}", *(f"{INDENT}{line}".rstrip() for line in lines)]


def folded(findings: Iterable[Finding]) -> list[tuple[int, str]]:
    """Return line number and message of each finding.

    Where more than FEW findings differ only in the entry of a list or in the missing file, the first stands for all, and
    its message names the lines of the others.
    """
    alike: dict[str, list[Finding]] = {}
    for finding in findings:
        alike.setdefault(ENTRY.sub("", finding.message), []).append(finding)
    lines: list[tuple[int, str]] = []
    for first, *others in alike.values():
        if len(others) < FEW:
            lines += [(finding.line, finding.message) for finding in (first, *others)]
        else:
            where = ", ".join(str(finding.line) for finding in others[:NAMED]) + " …" * (len(others) > NAMED)
            lines.append((first.line, f"{first.message} (and {len(others)} times more, in lines {where})"))
    return sorted(lines, key=lambda each: each[0])
