"""l3 report: writes a page with plots and pictures of artifacts."""

from pathlib import Path

import click

from l3cli.cli import options as declared
from l3cli.cli.results import Result
from l3cli.options.commands import ReportOptions


@click.command()
@click.argument("artifacts", type=declared.FILE, nargs=-1, required=True, metavar="ARTIFACT.h5|SEQUENCE.json…")
@declared.output("HTML page to write")
@declared.of(ReportOptions)
def report(artifacts: tuple[Path, ...], output: Path, options: ReportOptions) -> Result:
    """Show camera models, training sets and transform tables on one HTML page that needs no network.

    Every table is evaluated on every training set with the same colour filter array, except for training sets that were used
    to train the table. Several evaluations are shown side by side. If you specify no camera model, the page shows the camera
    models in the training sets. JSON files from "l3 evaluate --sequence" share one plot over time.

    \b
    Example: l3 report camera.h5 training.h5 table.h5 unseen.h5 -o report.html
    """
    from l3cli.stages.report import report as stage

    files = stage(artifacts, output, options)
    return Result({"page": str(output)}, files=files)
