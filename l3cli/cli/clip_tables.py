"""Outcome of rendered clips, as a table on stdout."""

from typing import TYPE_CHECKING, Any

from l3cli.cli.results import Result
from l3cli.cli.terminal import show_table, with_options

if TYPE_CHECKING:
    from l3cli.stages.rendering.clips import Summary


def clips_result(summary: "Summary", fault: BaseException | None = None, show_text: bool = False) -> Result:
    """The result of l3 render; with `show_text`, or where a run over many clips was ended by `fault`, with a table."""
    document = _worded(summary.document())
    text = (lambda: _table(document)) if show_text or fault else None
    return Result(document, text, fault, summary.exit_code)


def _worded(value: Any) -> Any:
    """A document in which messages name options."""
    if isinstance(value, dict):
        return {key: _worded(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_worded(each) for each in value]
    return with_options(value) if isinstance(value, str) else value


def _table(document: dict[str, Any]) -> None:
    rows = []
    for clip in document["clips"]:
        rate = "" if clip["frames_per_s"] is None else f"{clip['frames_per_s']:.3g}"
        counts = [str(clip["frames"]), rate, str(clip["left_out"]), str(len(clip["warnings"]))]
        rows.append([clip["clip"], clip["output"], *counts, clip["state"]])
    states = ", ".join(f"{document[f'clips_{state}']} {state}" for state in ("rendered", "kept", "failed"))
    total = f"clips: {states}; frames: {document['frames']}, {document['left_out']} left out"
    show_table([], ["clip", "output", "frames", "frames/s", "left out", "warnings", ""], rows, total)
