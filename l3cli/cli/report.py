"""l3 report: any set of artifacts as one page."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from l3cli.cli import options

if TYPE_CHECKING:
    from l3cli.stages.console import Console


@click.command()
@click.argument("artifacts", type=options.FILE, nargs=-1, required=True, metavar="ARTIFACT.h5...")
@options.output("HTML page to write")
@options.backend
@options.force
@options.quiet
def report(artifacts: tuple[Path, ...], output: Path, backend: str, force: bool, console: "Console") -> None:
    """Show camera models, training sets and transform tables on one page that needs no network.

    Every table is evaluated on every training set that it was not trained on. A camera is shown once; where no camera
    model is given, those inside the training sets are shown.

    \b
    Example: l3 report camera.h5 training.h5 table.h5 unseen.h5 -o report.html
    """
    from l3cli.cli import report_sections
    from l3cli.cli.cautions import caution_kernels
    from l3cli.errors import RecipeError
    from l3cli.files import write_whole
    from l3cli.report.page import LIMIT, render_page

    if output.suffix != ".html":
        raise RecipeError(f"{output}: a report is a page; name a file that ends in .html")
    claims = options.claims(console)
    claims.spare(*artifacts)
    claims.claim_file(output, force)
    given = report_sections.sort(artifacts)
    title, lead, sections = report_sections.compose(given, backend, console)
    page = render_page(title, lead, sections).encode()
    write_whole(output, page)
    caution_kernels(console)
    much = "; fewer files would make a lighter page" if len(page) > LIMIT else ""
    console.say(f"{output}: {len(page) / 1e6:.2f} MB, {len(sections)} sections{much}")
