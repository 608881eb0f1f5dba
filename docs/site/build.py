"""Build the site of docs/ in a folder, with warnings as errors, and check the pages: python docs/site/build.py FOLDER"""

import shutil
import sys
from pathlib import Path

from built import faults
from gather import BUILT, gather
from sphinx.cmd.build import main as sphinx


def main(folder: Path) -> int:
    """Return 0, or print what is wrong and return the exit code."""
    pages, site = folder / "pages", folder / "html"
    for each in (pages, site):
        shutil.rmtree(each, ignore_errors=True)
    (folder / BUILT).mkdir(parents=True, exist_ok=True)
    gather(pages)
    config = Path(__file__).parent
    arguments = ["-q", "-W", "--keep-going", "-c", str(config), "-d", str(folder / BUILT), "-b", "html"]
    if code := sphinx([*arguments, str(pages), str(site)]):
        return int(code)
    wrong = faults(site)
    for line in wrong:
        print(line, file=sys.stderr)
    print(f"{site}: {len(list(site.rglob('*.html')))} pages")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
