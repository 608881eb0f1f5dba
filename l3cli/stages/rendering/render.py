"""The `l3 render` stage, which renders raw frames to a picture, numbered files, a folder, a video or a stream."""

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
    """Render raw frames with a transform table to pictures or a video.

    Parameters
    ----------
    table : Path
        File of the transform table.
    inputs : tuple of Path
        Files with one frame each, or one sequence.
    output : Path
        Picture, pattern of numbered pictures, folder, video, or "-" for standard output.
    options : RenderOptions
        Options of `l3 render`.
    clips : Renderers, optional
        Renderers that several clips share. Set this only if the input is one of several clips.

    Returns
    -------
    Tally
        Numbers of rendered and skipped frames, and the files.

    Raises
    ------
    RecipeError, InputFileError, DeviceError, L3Error
        If the frames cannot be rendered. Except for damaged frames, which are found only when they are read, errors are
        raised before anything is written.
    """
    with OutputGuard(options.console) as guard:
        job = open_job(table, inputs, output, options, guard, is_clip=clips is not None)
        look = choose_look(job)
        return run(job, look, clips or Renderers())
