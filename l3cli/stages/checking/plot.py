"""A page on the camera of a recipe, as l3 report makes of a measured one."""

from collections.abc import Sequence
from pathlib import Path

from l3cli.artifacts.camera_recipe import camera_files, load_camera
from l3cli.errors import RecipeError
from l3cli.options.tools import CheckOptions
from l3cli.report.camera import camera_section
from l3cli.report.page import render_page
from l3cli.stages.checking.check import Judgement
from l3cli.stages.checking.kinds import CAMERA
from l3cli.stages.report import figures_of_camera
from l3cli.system.files import write_whole
from l3cli.system.ledger import note_places
from l3cli.system.output_guard import OutputGuard


def plot(judged: Sequence[Judgement], output: Path, options: CheckOptions) -> None:
    """Draw array, responsivities and noise of the camera recipes without faults; RecipeError if there is none, or if the
    output is no page, L3Error if it cannot be written."""
    paths = [judgement.path for judgement in judged if judgement.kind == CAMERA and not judgement.findings]
    if output.suffix != ".html":
        raise RecipeError(f"{output}: a plot is a page; name a file that ends in .html")
    if not paths:
        raise RecipeError(f"{output}: there is no camera recipe without faults to draw; give one beside ‹plot›")
    with OutputGuard(options.console) as claims:
        claims.protect(*(file for each in judged for file in (each.path, *each.files)))
        claims.protect(*(file for path in paths for file in camera_files(path)))
        claims.claim_file(output, options.force)
        note_places([output])
        cameras = [(path, load_camera(path)) for path in paths]
        sections = [camera_section(camera, figures_of_camera(camera), path.name) for path, camera in cameras]
        title = ", ".join(camera.name for _, camera in cameras)
        write_whole(output, render_page(title, "Described by recipes, not measured.", sections).encode())
        options.console.info(f"{output}: {len(cameras)} camera{'s' if len(cameras) > 1 else ''}")
