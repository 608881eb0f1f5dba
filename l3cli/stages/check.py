"""The `l3 check` and `l3 schema` stages.

`l3 check` finds faults in recipes and prints their line numbers. `l3 schema` prints the JSON schema of a type of recipe.
Most checks are in the packages that define the recipes. The checks of design recipes and scene files are in this module,
because they need several packages that do not import each other.
"""

import contextlib
import itertools
import os
import re
import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import CameraRecipe, PhaseRecipe, camera_recipe_faults, load_camera
from l3cli.artifacts.recipe_source import Meaning, RecipeSource, key_in, keys_of
from l3cli.calibration.captures import check_polarisers
from l3cli.design.recipe import DesignRecipe, design_faults, filter_curves, level_name, pixel_of
from l3cli.errors import InputFileError, L3Error, RecipeError, suggestion
from l3cli.io.file_names import find_scenes
from l3cli.io.measurement_check import measurement_faults, measurement_lines, measurement_summary
from l3cli.io.measurement_recipe import CorrectionRecipe, MeasurementRecipe
from l3cli.io.measurements import measurements_of
from l3cli.io.raw.files import BY_SUFFIX
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
from l3cli.stages.simulation.preparation import (
    polarisation_notes,
    prepare,
    refusals,
    scene_files,
    size_of,
    unknown_of,
)
from l3cli.training.recipe import TrainingRecipe, class_recipe_faults
from l3cli.training.summary import class_lines, class_meaning


def files_named(path: Path, content: Mapping[str, Any]) -> tuple[Path, ...]:
    """Find the existing files to which a recipe refers.

    Recipes can contain file names, patterns such as "*.exr", and mixtures of illuminants such as "0.7 D65 + 0.3 lamp.csv".
    Every text in the recipe is tried as a file name. Missing files are skipped.

    Parameters
    ----------
    path : Path
        Path of the recipe. File names are relative to its folder.
    content : mapping
        Content of the recipe.
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
    """Find the faults in a design recipe. Its files of spectra are checked only if the recipe itself has no faults."""
    wrong = list(design_faults(recipe))
    yield from wrong
    if not wrong:
        yield from source.attempt(None, _design_curves, recipe, source)


def _design_curves(recipe: DesignRecipe, source: RecipeSource) -> Any:
    camera = pixel_of(recipe.pixel, source.path.parent)
    return filter_curves(recipe, camera, camera.wavelength, source.path.parent)


def design_meaning(recipe: DesignRecipe, source: RecipeSource) -> Meaning:
    """Summarise a design recipe for `l3 check`: peak quantum efficiencies of the filters, light levels, and warnings.

    The returned list of faults is empty.
    """
    curves = _design_curves(recipe, source)
    camera = pixel_of(recipe.pixel, source.path.parent)
    filters = Filters.of(dict(zip(recipe.filters, curves, strict=True)), camera.wavelength)
    return {
        "filters": dict(zip(recipe.filters, curves.max(axis=1).tolist(), strict=True)),
        "levels": list(map(level_name, recipe.level)),
        "warnings": named_beyond_known((level.illuminant for level in recipe.level), filters),
    }, []


def design_lines(figures: dict[str, Any], width: int | None) -> list[str]:
    """Format the result of `design_meaning` as lines of text."""
    filters = ", ".join(f"{name} {100 * peak:.0f} %" for name, peak in figures["filters"].items())
    return [f"filters, peak quantum efficiency: {filters}", f"levels: {'; '.join(figures['levels'])}"]


def scene_recipe_faults(recipe: SceneRecipe, source: RecipeSource) -> Iterator[Fault]:
    """Find the faults in a scene recipe, including missing files and, if the camera is known, conflicts with the camera."""
    yield from scene_faults(recipe, source.camera)
    yield from curve_faults(recipe, source)
    for number, scene in enumerate(recipe.scene):
        yield from source.attempt(("scene", number, "file"), scene_files, scene, source.path)
    for number, pair in enumerate(recipe.pair):
        for side, name in (("raw", pair.raw), ("picture", pair.picture)):
            if not os.path.isfile(source.file(name)):
                message = f"{source.file(name)} does not exist; write the path of a file, relative to the recipe"
                yield fault(message, f"pair.{number}.{side}")


def scene_meaning(recipe: SceneRecipe, source: RecipeSource) -> Meaning:
    """Summarise a scene recipe for `l3 check`: numbers of scenes, clips and frames, illuminants, luminances and exposures.

    If the camera is known, l3 also checks the scene files, for example their size, and adds frame sizes and warnings to the
    summary. Returns the summary and the faults in the scene files.
    """
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
    if bad:
        return document, bad
    warnings = unknown_of(run, source.camera) + polarisation_notes(run, files)[0]
    return document | _sizes(recipe, run, files) | {"warnings": warnings}, []


def _sizes(recipe: SceneRecipe, run: SimulationRun, files: list[list[Path]]) -> dict[str, Any]:
    """Summarise frame sizes: camera name, largest frame in pixels and in bytes, and total number of bytes."""
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


def measurement_meaning(recipe: MeasurementRecipe | CorrectionRecipe, source: RecipeSource) -> Meaning:
    """Summarise a measurement file for `l3 check`, and find faults in its polariser frames.

    Frames behind a rotating polariser must agree with each other and with the stated angles of the channels. If the file
    contains no angles, the angles of the camera in `source` are used.
    """
    measured = measurements_of(recipe, source.path)
    camera, body = source.camera, measured.body
    if body.polarisers is None and camera is not None and camera.channels == body.channels:
        measured = replace(measured, body=replace(body, polarisers=camera.polarisers))
    faults = source.attempt(None, check_polarisers, measured)
    return measurement_summary(recipe, measured), list(faults)


class Kind(NamedTuple):
    """A type of recipe, such as camera recipes or class recipes."""

    name: str
    # class of a complete recipe and, if it differs, class of a recipe with the key `base`
    recipes: tuple[type[Recipe], ...]
    folder: str | None  # folder in configs/ with l3's own recipes of this type

    @property
    def title(self) -> str:
        return self.recipes[0].title

    def structure(self, content: Mapping[str, Any]) -> type[Recipe]:
        """Return the class that defines the keys of a recipe. It depends on whether the recipe has a base."""
        return self.recipes[-1] if "base" in content else self.recipes[0]


CAMERA = "camera"
# additional keys that identify the type of a recipe with the key `base`
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
    """Determine the type of a recipe from its keys. Returns None if two types fit equally well.

    The type with the most characteristic keys, which no other type has, is chosen. In a tie, the number of keys with
    suitable values decides.
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
    """Return whether a value has the required form: table, list or single value. The content is not checked."""
    try:
        msgspec.convert(value, field.type)
    except msgspec.ValidationError as error:
        return " - at " in str(error) or "missing" in str(error) or "unknown" in str(error)
    return True


def names() -> dict[str, list[tuple[Kind, Path]]]:
    """List the recipes included with l3: for each name, the type and path of every recipe with this name."""
    known: dict[str, list[tuple[Kind, Path]]] = {}
    for kind in KINDS.values():
        for name, path in (known_recipes(kind.folder) if kind.folder else {}).items():
            known.setdefault(name, []).append((kind, path))
    return known


def schema(kind: str) -> dict[str, Any]:
    """Return the JSON schema of a type of recipe. `kind` is a key of KINDS."""
    return schema_of(KINDS[kind].recipes, KINDS[kind].title)


class Checks(NamedTuple):
    """The functions that check and summarise recipes of one type."""

    faults: Callable[[Any, RecipeSource], Iterator[Fault]]
    meaning: Callable[[Any, RecipeSource], Meaning]
    lines: Callable[[dict[str, Any], int | None], list[str]]  # formats the summary as text of a given width


CHECKS = {
    CAMERA: Checks(camera_recipe_faults, camera_meaning, camera_lines),
    "lab": Checks(lab_recipe_faults, lab_meaning, lab_lines),
    "scenes": Checks(scene_recipe_faults, scene_meaning, scene_lines),
    "classes": Checks(class_recipe_faults, class_meaning, class_lines),
    "design": Checks(design_recipe_faults, design_meaning, design_lines),
    "measurements": Checks(measurement_faults, measurement_meaning, measurement_lines),
}
INDENT = "  "
# parts in which the messages of similar faults may differ: the number of a list entry, or the name of a missing file
ENTRY = re.compile(r"\[\d+\]|^.*(?= does not exist)")
MAX_LISTED = 3  # if more than this number of faults are similar, they are printed as one line
MAX_LINE_NUMBERS = 8  # maximum number of line numbers that are listed for similar faults
SYNTAX = re.compile(r"\(at line (\d+), column \d+\)")  # position in an error message of the TOML parser


class Finding(NamedTuple):
    """A fault in a file, with its line number and key."""

    line: int
    key: str
    message: str


@dataclass(frozen=True)
class Judgement:
    """Result of a check: the faults in a file or, if it has none, a summary of its content."""

    path: Path
    kind: str | None = None  # type of the recipe, a key of KINDS; None if unknown
    findings: tuple[Finding, ...] = ()  # the first faults, at most LISTED_FAULTS
    more: int = 0  # number of faults that are not in `findings`
    meaning: dict[str, Any] = field(default_factory=dict)
    files: tuple[Path, ...] = ()  # existing files to which the recipe refers

    def document(self) -> dict[str, Any]:
        """Return the result as JSON data, as printed by `l3 check --json`."""
        found = [finding._asdict() for finding in self.findings]
        return {
            "file": str(self.path),
            "kind": self.kind,
            "faults": found,
            "more_faults": self.more,
            "meaning": self.meaning,
        }


def check(given: Sequence[str]) -> list[Judgement]:
    """Check recipes and return the results in the order of the arguments.

    Camera recipes are checked first. Every other recipe is then checked together with a camera: the first valid camera
    recipe in the same folder or, if that folder has none, the first valid camera recipe in any folder. Without a valid
    camera recipe, the other recipes are checked alone. Duplicate files are checked once.

    Parameters
    ----------
    given : sequence of str
        Paths of files or folders, or names of recipes included with l3.

    Returns
    -------
    list of Judgement
        The result for each file.

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
    """Find the recipe files that an argument of `l3 check` specifies.

    In a folder, camera.toml comes first. The other files are sorted by name.

    Parameters
    ----------
    name : str
        Path of a file or of a folder of recipes, or name of a recipe or benchmark included with l3. Recipes of different
        types may have the same name.

    Raises
    ------
    InputFileError
        If the path does not exist, or if the folder contains no recipes.
    RecipeError
        If no recipe has this name.
    """
    path = Path(name)
    if path.exists() and not path.is_dir():  # reading the file will reject devices and other special files
        return [path]
    if name in names():
        return [file for _, file in names()[name]]
    folder = known_benchmarks().get(name, path)
    if folder.is_dir():
        files = sorted(folder.glob("*.toml"), key=lambda each: (each.name != "camera.toml", each.name))
        if not files:
            raise InputFileError(f"{folder} contains no recipes (*.toml); specify a recipe or a folder of recipes")
        return files
    if os.sep in name or path.suffix:
        raise InputFileError(f"{name} does not exist; specify a recipe or a measurement file (TOML)")
    raise RecipeError(f'no file or recipe is called "{name}"; {suggestion(name, [*names(), *known_benchmarks()])}')


def _is_camera(path: Path) -> bool:
    try:
        kind = kind_of(parse_toml(read_text(path), str(path)))
    except L3Error:
        return False
    return kind is not None and kind.name == CAMERA


def judge(path: Path, camera: CameraModel | None = None) -> Judgement:
    """Check one file and, if `camera` is set, whether it suits this camera.

    The folder determines the type of l3's own recipes, and the keys determine the type of all other files. A file that is
    unreadable, not valid TOML or of unknown type results in a single fault.
    """
    try:
        text = read_text(path, "a recipe or a measurement file")
        content = parse_toml(text, str(path))
    except L3Error as error:
        if path.suffix.lower() in BY_SUFFIX:
            message = f'is not a recipe; describe the file with "l3 info {shlex.quote(str(path))}"'
            return Judgement(path, None, (Finding(1, "", message),))
        message = str(error).removeprefix(f"{path} ").removeprefix(f"{path}: ")
        at = SYNTAX.search(message)
        return Judgement(path, None, (Finding(int(at[1]) if at else 1, "", message),))
    kind = next((kind for found in names().values() for kind, file in found if file == path), None) or kind_of(content)
    if kind is None:
        kinds = ", ".join(each.title for each in KINDS.values())
        message = (
            f"the type of this file is unclear from its keys: {kinds}; add a key that occurs in only one of these types, "
            "such as responsivity"
        )
        return Judgement(path, None, (Finding(1, "", message),))
    meaning, faults = _judged(kind, RecipeSource(path, content, camera))
    findings = _findings([each for each in faults if each.message][:LISTED_FAULTS], text)
    more = len(faults) - len(findings)
    return Judgement(path, kind.name, findings, more, {} if faults else meaning, files_named(path, content))


def _judged(kind: Kind, source: RecipeSource) -> tuple[dict[str, Any], list[Fault]]:
    """Check a recipe, and return its summary and its faults.

    The types of the values are checked first, then their meaning. If there are no faults, the summary is computed, which can
    reveal further faults, for example in files to which the recipe refers.
    """
    recipe, faults = typed(dict(source.content), kind.structure(source.content))
    if recipe is not None:
        others = about_others(CHECKS[kind.name].faults(recipe, source), faults)
        # One additional fault is enough to show that the printed list is incomplete.
        faults += itertools.islice(others, max(LISTED_FAULTS + 1 - len(faults), 0))
    meaning: dict[str, Any] = {}
    if not faults:
        try:
            meaning, faults = CHECKS[kind.name].meaning(recipe, source)
        except (L3Error, OSError) as error:
            message = source.plain(error)
            faults = [Fault(message, (key_in(message, source.content),))]
    return meaning, faults


def _findings(faults: Iterable[Fault], text: str) -> tuple[Finding, ...]:
    """Add line numbers to faults, and sort them by line."""
    lines = key_lines(text)
    found = []
    for message, keys in faults:
        key = next((key for key in keys if key in lines), keys[0] if keys else ())  # prefer a key that occurs in the file
        found.append(Finding(line_of(key, lines), _written(key), message))
    return tuple(sorted(found, key=lambda finding: finding.line))


def _written(key: KeyPath) -> str:
    """Format a key for messages, such as scene[2].size. List entries are counted from 1."""
    return "".join(f"[{part + 1}]" if isinstance(part, int) else f".{part}" for part in key).lstrip(".")


# --------------------------------------------------------------------------------------------------------- text


def as_text(judgement: Judgement, width: int | None = None) -> list[str]:
    """Format the result of a check as lines of text.

    Faults are printed as `file:line: message`, which editors recognise. Similar faults share a line. If there are
    no faults, the lines contain a summary of the recipe, followed by warnings. Tables are at most `width` characters wide.
    """
    if judgement.findings:
        lines = [f"{judgement.path}:{line}: {message}" for line, message in folded(judgement.findings)]
        more = f"{f'{judgement.more} ' * (judgement.more > 1)}more faults are not listed"
        return [*lines, f"{judgement.path}: {more}"] if judgement.more else lines
    assert judgement.kind is not None
    inside = None if width is None else width - len(INDENT)
    lines = CHECKS[judgement.kind].lines(judgement.meaning, inside) if judgement.meaning else []
    lines += [f"warning: {text}" for text in judgement.meaning.get("warnings", [])]
    return [f"{judgement.path}: {KINDS[judgement.kind].title}", *(f"{INDENT}{line}".rstrip() for line in lines)]


def folded(findings: Iterable[Finding]) -> list[tuple[int, str]]:
    """Return line number and message of each finding, but combine similar findings.

    Messages of similar findings differ only in the number of a list entry or in the name of a missing file. If more than
    MAX_LISTED findings are similar, only the first is returned, and its message lists the lines of the others.
    """
    alike: dict[str, list[Finding]] = {}
    for finding in findings:
        alike.setdefault(ENTRY.sub("", finding.message), []).append(finding)
    lines: list[tuple[int, str]] = []
    for first, *others in alike.values():
        if len(others) < MAX_LISTED:
            lines += [(finding.line, finding.message) for finding in (first, *others)]
        else:
            where = ", ".join(str(finding.line) for finding in others[:MAX_LINE_NUMBERS])
            where += " …" * (len(others) > MAX_LINE_NUMBERS)
            lines.append((first.line, f"{first.message} ({len(others)} similar faults in lines {where})"))
    return sorted(lines, key=lambda each: each[0])
