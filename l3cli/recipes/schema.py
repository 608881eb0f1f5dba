"""JSON schemas (2020-12): of recipes, made of the declared types, for editors that check TOML with them, and of the JSON
that commands print, with the whole of its account of the run and the keys of its results."""

import ast
import functools
import inspect
import io
import textwrap
import tokenize
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from l3cli.recipes.toml import Recipe, tables_in

DIALECT = "https://json-schema.org/draft/2020-12/schema"
PLACE = "#/$defs/{name}"


def schema_of(
    recipes: Sequence[type[Recipe]], title: str, described_by: Mapping[str, Sequence[type[Recipe]]]
) -> dict[str, Any]:
    """Return the schema of a file that is one of `recipes`. What a key means is the comment beside its declaration; for a
    structure that is put together of others, `described_by` names those, by its name."""
    roots, tables = msgspec.json.schema_components(recipes, ref_template=PLACE)
    classes = _structures(recipes)
    for name, table in tables.items():
        if "description" in table:
            table["description"] = " ".join(table["description"].split())
        meanings: dict[str, str] = {}
        for each in (*described_by.get(name, ()), *reversed(classes[name].__mro__)):
            meanings |= _comments(each) if isinstance(each, type) and issubclass(each, Recipe) and each is not Recipe else {}
        for key, value in table.get("properties", {}).items():
            table["properties"][key] = _plain(value) | ({"description": meanings[key]} if key in meanings else {})
    whole: dict[str, Any] = {"$schema": DIALECT, "title": title}
    whole |= roots[0] if len(roots) == 1 else {"anyOf": list(roots)}
    return whole | {"$defs": tables}


def _plain(value: Any) -> Any:
    """Return a property without what TOML has not, null, and in words that older dialects understand alike."""
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if not isinstance(value, dict):
        return value
    value = {key: _plain(each) for key, each in value.items() if not (key == "default" and each is None)}
    if {"type": "null"} in value.get("anyOf", []):
        kinds = [each for each in value.pop("anyOf") if each != {"type": "null"}]
        value = (kinds[0] if len(kinds) == 1 else {"anyOf": kinds}) | value
    first, *others = value.get("prefixItems", [None])
    if first is not None and all(each == first for each in others):  # so many of one type
        del value["prefixItems"]
        value["items"] = first
    return value


def _structures(recipes: Sequence[type[Recipe]]) -> dict[str, type[Recipe]]:
    """Return the structures that recipes are made of, by name."""
    found: dict[str, type[Recipe]] = {}
    left = list(recipes)
    while left:
        kind = left.pop()
        if kind.__name__ not in found:
            found[kind.__name__] = kind
            left += [each for field in msgspec.structs.fields(kind) for each in tables_in(field.type)]
    return found


@functools.cache
def _comments(kind: type) -> dict[str, str]:
    """Return the comment of each key of a structure: above its declaration, or at the ends of the declaration's lines."""
    try:
        source = textwrap.dedent(inspect.getsource(kind))
    except (OSError, TypeError):
        return {}
    lines, own = _comment_lines(source), {}
    (tree,) = ast.parse(source).body
    for node in getattr(tree, "body", []):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            above = node.lineno
            while lines.get(above - 1, (False, ""))[0]:
                above -= 1
            texts = [lines[line][1] for line in range(above, (node.end_lineno or node.lineno) + 1) if line in lines]
            if texts:
                own[node.target.id] = " ".join(texts)
    return own


def _comment_lines(source: str) -> dict[int, tuple[bool, str]]:
    """Return, for every line with a comment, whether it holds nothing else, and the comment."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return {
        token.start[0]: (token.line.strip().startswith("#"), token.string.lstrip("# "))
        for token in tokens
        if token.type == tokenize.COMMENT and not token.string.startswith("# fmt")
    }


# ------------------------------------------------------------------------------------------------------ outputs

TEXT, COUNT, SECONDS = {"type": "string"}, {"type": "integer", "minimum": 0}, {"type": "number", "minimum": 0}


def _listed(of: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": of}


def _maybe(of: dict[str, Any]) -> dict[str, Any]:
    return {"anyOf": [of, {"type": "null"}]}


def _structure(**keys: dict[str, Any]) -> dict[str, Any]:
    """Return an object with exactly these keys."""
    return {"type": "object", "properties": keys, "required": list(keys), "additionalProperties": False}


def _keys(names: str) -> dict[str, dict[str, Any]]:
    """Return the keys of any value."""
    return {name: {} for name in names.split(", ")}


def _described(kind: dict[str, Any], what: str) -> dict[str, Any]:
    return kind | {"description": what}


FILE = _structure(
    path=TEXT,
    bytes=_described(_maybe(COUNT), "null of what is no file, or has changed while it was worked on"),
    sha256=_described(_maybe({"type": "string", "pattern": "^[0-9a-f]{64}$"}), "null where bytes is"),
)
RUN = _structure(
    format=_described({"const": 1}, "raised when keys change"),
    command=TEXT,
    l3=_described(TEXT, "version"),
    exit_code=_described(COUNT, "0, 1, 2, 3, 4, 130 or 143"),
    error=_maybe(
        _structure(kind={"enum": ["failure", "call", "input", "device", "interrupted", "terminated"]}, message=TEXT)
    ),
    warnings=_described(_listed(TEXT), "the first 1000, said or not"),
    messages=_described(_listed(TEXT), "the first 1000, said or not"),
    messages_left_out=_described(COUNT, "warnings and messages beyond these"),
    started=_described({"type": "string", "format": "date-time"}, "UTC"),
    seconds=_described(SECONDS, "of the whole command, by the clock, without computing digests"),
    steps=_described(
        _listed(_structure(what=TEXT, count=COUNT, seconds=SECONDS)), "work whose progress is shown, by its name"
    ),
    inputs=_described(
        {"type": "object", "additionalProperties": _listed(FILE)}, "files read, by role; none where an error ends the run"
    ),
    outputs=_described(_listed(FILE), "files written that are there; none where an error ends the run"),
)
CLIP = _structure(
    clip=TEXT,
    output=TEXT,
    state={"enum": ["rendered", "kept", "failed"]},
    frames=COUNT,
    left_out=_described(COUNT, "frames"),
    seconds=SECONDS,
    frames_per_s=_maybe(SECONDS),
    frame_times=_described(
        _maybe({"enum": ["even", "kept", "lost"]}),
        "evenly spaced; uneven, of a variable rate or with gaps, and kept in the video, or lost; null of pictures",
    ),
    warnings=_listed(TEXT),
    error=_maybe(TEXT),
)
ANY: dict[str, Any] = {}
RESULTS: dict[str, dict[str, dict[str, Any]]] = {  # command → keys of its results; a call has those of what it is asked for
    "calibrate": {
        "measurements": _described(TEXT, "the draft, where one is asked for"),
        "camera": _described(ANY, "name → value and unit"),
        **_keys(
            "channels, lights, bands, gains, photos, prior, next light, smoothing, responsivity, declared, left out, defects"
        ),
        **_keys("defect map, corner fall-off %, saturation reached"),
        "curves": _described(ANY, "range, peak and width of each channel, and the files that hold them"),
        "truth": _described(ANY, "where a truth is given: the same of the true camera, and errors"),
        "matrices": _described(ANY, "as of l3 export, where that is asked for"),
    },
    "simulate": {"training_set": TEXT, "frames": COUNT, "scenes_left_out": COUNT},
    "train": {
        "table": TEXT,
        "layers": _listed(_structure(classes=COUNT, without_patches=COUNT)),
        "pass": _described(_maybe(TEXT), "of merged shards, unless it is the last one"),
        "lights": _described(_listed(TEXT), "where there are transforms for each"),
        "partial_sums": TEXT,
        "shard": _described(_listed(COUNT), "number from 1, of how many"),
    },
    "render": {
        "clips": _listed(CLIP),
        "clips_rendered": COUNT,
        "clips_kept": COUNT,
        "clips_failed": COUNT,
        "frames": COUNT,
        "left_out": _described(COUNT, "frames"),
    },
    "evaluate": _keys(
        "format, camera, outputs, viewing, border, pipelines, frames, mean, better, by_level, by_illuminant, by_gain, "
        "by_patch, by_band, by_class, worst_classes, standards, kind, rendered, ideal, motion, still_share, temporal_sigma, "
        "patch_sigma, largest_jump, largest_jump_frame, warped_error, psnr, mean_delta_e"
    ),
    "report": {"page": TEXT},
    "compare": {
        "curves": _described(ANY, "of each camera its figures over luminance, cd/m²"),
        "crossings": _described(ANY, "luminances, cd/m², at which the better of two cameras changes"),
        "same_scenes": _described(_maybe({"type": "boolean"}), "null where not every frame says what it shows"),
        "verdicts": _described(_listed(TEXT), "which camera is better where, and by how much; where each clips"),
    },
    "design": {
        **_keys("moments, patches, tried, unit, bayer"),
        "lights": _described(ANY, "of moments: illuminant → principal spectra and the share of power that they leave out"),
        "design": TEXT,
        "levels": _listed(TEXT),
        "verdict": _described(_listed(TEXT), "what beats Bayer's array at each level, by how much"),
        "arrays": _described(
            ANY, "best first: rows of filters, predicted error at each level, that of Bayer of its filters"
        ),
    },
    "info": _keys(
        "kind, version, history, datasets, insight, digest, different, l3, python, system, libraries, devices, decoding"
    ),
    "export": {
        "files": _described(_listed(TEXT), "of a table"),
        "matrices": _described(ANY, "of a camera: mean ΔE00 … by light"),
    },
    "bench": _keys("devices, results"),
    "check": {
        "files": _listed(
            _structure(
                file=TEXT,
                kind=_maybe(TEXT),
                faults=_listed(_structure(line=COUNT, key=TEXT, message=TEXT)),
                more_faults=COUNT,
                meaning={"type": "object"},
            )
        )
    },
    "schema": {"schema": {"type": "object"}},
    "lab": {"measurements": TEXT},
    "init": {"folders": _listed(TEXT), "recipes": _described({"type": "object"}, "name → summary, without arguments")},
}
DRY_RUN = _structure(
    reads={"type": "object", "additionalProperties": _listed(TEXT)},
    makes=_listed(_structure(path=TEXT, what=TEXT, bytes=_maybe(COUNT))),
)


def output_schema() -> dict[str, Any]:
    """Return the schema of the JSON that any command prints."""
    document: dict[str, Any] = {"type": "object", "properties": {"run": {"$ref": "#/$defs/run"}}, "required": ["run"]}
    of_command = [
        {
            "if": {"properties": {"run": {"properties": {"command": {"const": command}}}}},
            "then": {"properties": keys | {"dry_run": {"$ref": "#/$defs/dry_run"}}},
        }
        for command, keys in RESULTS.items()
    ]
    title = "what an l3 command prints as JSON"
    document |= {"allOf": of_command, "unevaluatedProperties": False}
    return {"$schema": DIALECT, "title": title, **document, "$defs": {"run": RUN, "dry_run": DRY_RUN}}
