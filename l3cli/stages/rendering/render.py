"""The render stage: raw frames through a table into a picture, numbered files, a folder, a video or a stream."""

from pathlib import Path

from l3cli.options.render import RenderOptions
from l3cli.stages.rendering.job import open_job
from l3cli.stages.rendering.look import choose_look
from l3cli.stages.rendering.pictures import Renderers
from l3cli.stages.rendering.reports import Tally
from l3cli.stages.rendering.run import run
from l3cli.system.outputs import OutputGuard


def render(
    table: Path, inputs: tuple[Path, ...], output: Path, options: RenderOptions, clips: Renderers | None = None
) -> Tally:
    """Render raw frames through a table into pictures or video.

    Parameters
    ----------
    table : Path
        File of the transform table.
    inputs : tuple of Path
        Files of one frame each, or one sequence.
    output : Path
        Picture, pattern of numbered pictures, folder, video, or "-" for a stream.
    options : RenderOptions
    clips : Renderers, optional
        Set for one of several clips: the renderers that the clips share.

    Returns
    -------
    Tally
        Numbers of frames rendered and left out, and the files.

    Raises
    ------
    RecipeError, InputFileError, DeviceError, L3Error
        Before anything is written, unless an input turns out to be damaged when it is read.
    """
    with OutputGuard(options.console) as guard:
        job = open_job(table, inputs, output, options, guard, is_clip=clips is not None)
        look = choose_look(job)
        return run(job, look, clips or Renderers())
