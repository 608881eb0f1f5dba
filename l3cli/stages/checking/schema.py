"""JSON schemas: of each kind of recipe, and of the JSON that commands print, with the whole of its account of the run and
the keys of its results."""

from typing import Any

from l3cli.classes import chroma, contrast, level, saturation
from l3cli.recipes.schema import DIALECT, schema_of
from l3cli.stages.checking.kinds import KINDS

OUTPUT = "output"
FEATURES = {"ClassRecipe": tuple(feature.Options for feature in (level, contrast, saturation, chroma))}
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
        **_keys("channels, lights, bands, photos, prior, next light, smoothing, responsivity, declared, left out, defects"),
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
        "format, camera, outputs, viewing, border, pipelines, frames, mean, better, by_level, by_illuminant, by_band, "
        "by_class, worst_classes, kind, rendered, ideal, motion, still_share, temporal_sigma, patch_sigma, largest_jump, "
        "largest_jump_frame, warped_error, psnr, mean_delta_e"
    ),
    "report": {"page": TEXT},
    "compare": {
        "curves": _described(ANY, "of each camera its figures over luminance, cd/m²"),
        "crossings": _described(ANY, "luminances, cd/m², at which the better of two cameras changes"),
        "same_scenes": _described(_maybe({"type": "boolean"}), "null where not every frame says what it shows"),
        "verdicts": _described(_listed(TEXT), "which camera is better where, and by how much; where each clips"),
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


def schema(kind: str) -> dict[str, Any]:
    """Return the schema of a kind (KINDS) of recipe, or of the JSON that commands print ("output")."""
    if kind == OUTPUT:
        return _output_schema()
    return schema_of(KINDS[kind].recipes, KINDS[kind].title, FEATURES)


def _output_schema() -> dict[str, Any]:
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
