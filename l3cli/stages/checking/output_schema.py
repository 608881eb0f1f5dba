"""The JSON schema of what commands print as JSON: how a command ran in full, of its results the keys and what they are."""

from typing import Any

from l3cli.recipe_schema import DIALECT

TEXT, COUNT, SECONDS = {"type": "string"}, {"type": "integer", "minimum": 0}, {"type": "number", "minimum": 0}


def _listed(of: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": of}


def _maybe(of: dict[str, Any]) -> dict[str, Any]:
    return {"anyOf": [of, {"type": "null"}]}


def _structure(**keys: dict[str, Any]) -> dict[str, Any]:
    """An object with exactly these keys."""
    return {"type": "object", "properties": keys, "required": list(keys), "additionalProperties": False}


def _keys(names: str) -> dict[str, dict[str, Any]]:
    """Keys of any value."""
    return {name: {} for name in names.split(", ")}


def _told(kind: dict[str, Any], what: str) -> dict[str, Any]:
    return kind | {"description": what}


FILE = _structure(
    path=TEXT,
    bytes=_told(_maybe(COUNT), "null of what is no file, or has changed while it was worked on"),
    sha256=_told(_maybe({"type": "string", "pattern": "^[0-9a-f]{64}$"}), "null where bytes is"),
)
RUN = _structure(
    format=_told({"const": 1}, "raised when keys change"),
    command=TEXT,
    l3=_told(TEXT, "version"),
    exit_code=_told(COUNT, "0, 1, 2, 3, 4, 130 or 143"),
    error=_maybe(
        _structure(kind={"enum": ["failure", "call", "input", "device", "interrupted", "terminated"]}, message=TEXT)
    ),
    warnings=_told(_listed(TEXT), "the first 1000, said or not"),
    messages=_told(_listed(TEXT), "the first 1000, said or not"),
    messages_left_out=_told(COUNT, "warnings and messages beyond these"),
    started=_told({"type": "string", "format": "date-time"}, "UTC"),
    seconds=_told(SECONDS, "of the whole command, by the clock, without computing digests"),
    steps=_told(_listed(_structure(what=TEXT, count=COUNT, seconds=SECONDS)), "work whose progress is shown, by its name"),
    inputs=_told(
        {"type": "object", "additionalProperties": _listed(FILE)}, "files read, by role; none where an error ends the run"
    ),
    outputs=_told(_listed(FILE), "files written that are there; none where an error ends the run"),
)
CLIP = _structure(
    clip=TEXT,
    output=TEXT,
    state={"enum": ["rendered", "kept", "failed"]},
    frames=COUNT,
    left_out=_told(COUNT, "frames"),
    seconds=SECONDS,
    frames_per_s=_maybe(SECONDS),
    warnings=_listed(TEXT),
    error=_maybe(TEXT),
)
ANY: dict[str, Any] = {}
RESULTS: dict[str, dict[str, dict[str, Any]]] = {  # command → keys of its results; a call has those of what it is asked for
    "calibrate": {
        "measurements": _told(TEXT, "the draft, where one is asked for"),
        "camera": _told(ANY, "name → value and unit"),
        **_keys("channels, lights, bands, photos, prior, next light, smoothing, responsivity, declared, left out, defects"),
        **_keys("defect map, corner fall-off %, saturation reached"),
        "truth": _told(ANY, "where a truth is given: the same of the true camera, and errors"),
        "matrices": _told(ANY, "as of l3 export, where that is asked for"),
    },
    "simulate": {"training_set": TEXT, "frames": COUNT, "scenes_left_out": COUNT},
    "train": {
        "table": TEXT,
        "layers": _listed(_structure(classes=COUNT, without_patches=COUNT)),
        "pass": _told(_maybe(TEXT), "of merged shards, unless it is the last one"),
        "lights": _told(_listed(TEXT), "where there are transforms for each"),
        "partial_sums": TEXT,
        "shard": _told(_listed(COUNT), "number from 1, of how many"),
    },
    "render": {
        "clips": _told(_listed(CLIP), "the last 1000"),
        "clips_rendered": COUNT,
        "clips_kept": COUNT,
        "clips_failed": COUNT,
        "frames": COUNT,
        "left_out": _told(COUNT, "frames"),
    },
    "evaluate": _keys(
        "format, camera, outputs, viewing, border, pipelines, frames, mean, better, by_level, by_illuminant, by_band, "
        "by_class, worst_classes, kind, rendered, ideal, motion, still_share, temporal_sigma, patch_sigma, largest_jump, "
        "largest_jump_frame, warped_error, psnr, mean_delta_e"
    ),
    "report": {"page": TEXT},
    "compare": {
        "curves": _told(ANY, "of each camera its figures over luminance, cd/m²"),
        "crossings": _told(ANY, "luminances, cd/m², at which the better of two cameras changes"),
    },
    "info": _keys("kind, version, history, datasets, insight, digest, different, l3, python, system, libraries, devices"),
    "export": {"files": _told(_listed(TEXT), "of a table"), "matrices": _told(ANY, "of a camera: mean ΔE00 … by light")},
    "bench": _keys("devices, results, peers, five_against_nine, simulate, train"),
    "check": {
        "files": _listed(
            _structure(
                file=TEXT,
                kind=_maybe(TEXT),
                faults=_listed(_structure(line=COUNT, key=TEXT, message=TEXT)),
                meaning={"type": "object"},
            )
        )
    },
    "schema": {"schema": {"type": "object"}},
    "lab": {"measurements": TEXT},
    "init": {"folders": _listed(TEXT), "recipes": _told({"type": "object"}, "name → summary, without arguments")},
}
DRY_RUN = _structure(
    reads={"type": "object", "additionalProperties": _listed(TEXT)},
    makes=_listed(_structure(path=TEXT, what=TEXT, bytes=_maybe(COUNT))),
)


def output_schema() -> dict[str, Any]:
    """The schema of what any command prints as JSON."""
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
