"""Inputs and outputs of rendering, for dry runs."""

from collections.abc import Sequence
from pathlib import Path

from l3cli.io.sequences import FrameSequence
from l3cli.options.render import RenderOptions
from l3cli.stages.plan import Made, before_work, is_dry
from l3cli.stages.rendering.destination import Destination, refuse_outputs
from l3cli.system.files import require_regular
from l3cli.system.ledger import is_noting

KINDS = {"stream": "y4m stream of", "video": "video of", "pattern": "numbered pictures of", "folder": "pictures of"}


def plan(
    table: Path, inputs: Sequence[Path], sequence: FrameSequence, destination: Destination, options: RenderOptions
) -> None:  # fmt: skip
    """State the files that are read and made; in a dry run, after the refusals that come before work."""
    if not (is_dry() or is_noting()):
        return  # there may be many frames
    frames = [] if sequence.is_stream else [frame for place, frame in enumerate(sequence.frames) if sequence.renders(place)]
    files = [pending.source for pending in frames if pending.source is not None]
    if is_dry():
        refuse_outputs(destination, sequence, options.force or options.resume)
        for file in files if not options.skip_bad else ():
            require_regular(file)
    rendered = sequence.rendered
    count = "as many frames as come" if rendered is None else f"{rendered} frame{'s' * (rendered > 1)}"
    made = Made(destination.path, f"{KINDS.get(destination.kind, 'picture of')} {count}")
    before_work({"table": [table], "inputs": files or inputs, "dark frames": options.dark}, made)
