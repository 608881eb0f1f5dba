"""The report stage: any set of artifacts → one page."""

from pathlib import Path

from l3cli.errors import RecipeError
from l3cli.files import write_whole
from l3cli.report.page import LIMIT, render_page
from l3cli.stages.claims import Claims
from l3cli.stages.console import Console
from l3cli.stages.input_warnings import warn_of_kernels
from l3cli.stages.plan import Made, before_work
from l3cli.stages.reporting.artifacts import by_kind
from l3cli.stages.reporting.sections import compose


def report(
    artifacts: tuple[Path, ...], output: Path, console: Console, *, backend: str = "opencl", force: bool = False
) -> None:
    """Write a page on camera models, training sets and transform tables; InputFileError if one is none of these, is damaged,
    or does not fit the others, RecipeError or L3Error if the output cannot be written."""
    if output.suffix != ".html":
        raise RecipeError(f"{output}: a report is a page; name a file that ends in .html")
    with Claims(console) as claims:
        claims.spare(*artifacts)
        claims.claim_file(output, force)
        kinds = by_kind(artifacts)
        before_work({"artifacts": artifacts}, Made(output, "page"))
        title, lead, sections = compose(kinds, backend, console)
        page = render_page(title, lead, sections).encode()
        write_whole(output, page)
        warn_of_kernels(console)
        much = "; fewer files would make a lighter page" if len(page) > LIMIT else ""
        console.say(f"{output}: {len(page) / 1e6:.2f} MB, {len(sections)} sections{much}")
