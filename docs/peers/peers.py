"""python docs/peers/peers.py [PART …] [--folder DIR]: tables of ours beside other methods, and the page docs/peers.md.

Training sets and tables lie in the folder (build/peers) and are not made again where they are there. What is named already
in figures.json stays as it is unless its part is named here; without names all parts are measured.
"""

import argparse
import functools
import json
import sys
from collections.abc import Callable
from pathlib import Path

import libraw_rivals
import making
import network
import rawtherapee
from judging import judged, of_bands, of_codes, of_pictures
from peers_page import Part, page
from rivals import PLAIN, Demosaic, Rival, gathered, installed

from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.evaluation.bands import bilinear, ppi_difference, spectral_difference
from l3cli.evaluation.demosaic import interpolate, malvar, menon
from l3cli.files import write_whole

FOLDER = Path(__file__).parent
FIGURES, PAGE = FOLDER / "figures.json", FOLDER.parent / "peers.md"
Programs = list[Callable[[], list[Rival]]]
OUR_METHODS = "l3's own"  # methods of the literature that l3 itself holds, as baselines


def bayer(folder: Path, data: Path, jobs: int) -> Part:
    sets, table = making.codes(folder, data, "bayer", jobs)
    programs: Programs = [_plain_bayer, _colour_demosaicing, functools.partial(libraw_rivals.bayer, False)]
    programs += [functools.partial(rawtherapee.bayer, False), functools.partial(network.rivals, (2, 2), False)]
    rivals, missing = gathered(programs)
    rows = judged(sets, {"benchmark-bayer": load(TransformTable, table)}, rivals, of_codes())
    return {"rows": rows, "missing": missing, "absent": [name for name in making.PICTURES if name not in sets]}


def xtrans(folder: Path, data: Path, jobs: int) -> Part:
    sets, table = making.codes(folder, data, "xtrans", jobs)
    own = [Rival("bilinear", OUR_METHODS, {PLAIN: interpolate})]
    programs: Programs = [
        lambda: own,
        libraw_rivals.xtrans,
        rawtherapee.xtrans,
        functools.partial(network.rivals, (6, 6), False),
    ]
    rivals, missing = gathered(programs)
    rows = judged(sets, {"benchmark-bayer, its array X-Trans": load(TransformTable, table)}, rivals, of_codes())
    return {"rows": rows, "missing": missing, "absent": [name for name in making.PICTURES if name not in sets]}


def bands(folder: Path, data: Path, jobs: int) -> Part:
    sets, table = making.bands(folder, data, jobs)
    methods = {"weighted bilinear": bilinear, "spectral difference": spectral_difference, "PPID": ppi_difference}
    rivals = [Rival(name, OUR_METHODS, {PLAIN: demosaic}) for name, demosaic in methods.items()]
    rows = judged(sets, {"bands": load(TransformTable, table)}, rivals, of_bands())
    return {"rows": rows, "missing": [], "absent": []}


def noise(folder: Path, data: Path, jobs: int) -> Part:
    sets, tables = making.noise(folder, data, jobs)
    programs: Programs = [_plain_bayer, _colour_demosaicing, functools.partial(libraw_rivals.bayer, True)]
    programs += [functools.partial(rawtherapee.bayer, True), functools.partial(network.rivals, (2, 2), True)]
    rivals, missing = gathered(programs)
    rows = judged(sets, {name: load(TransformTable, path) for name, path in tables.items()}, rivals, of_pictures())
    return {"rows": rows, "missing": missing, "absent": []}


PARTS: dict[str, Callable[[Path, Path, int], Part]] = {"bayer": bayer, "xtrans": xtrans, "bands": bands, "noise": noise}


def _plain_bayer() -> list[Rival]:
    return [Rival("bilinear", OUR_METHODS, {PLAIN: bilinear})]


def _colour_demosaicing() -> list[Rival]:
    program = installed("colour-demosaicing")
    methods: dict[str, Demosaic] = {"Malvar": malvar, "Menon": menon}
    return [Rival(name, program, {PLAIN: demosaic}) for name, demosaic in methods.items()]


def main(names: list[str], folder: Path, jobs: int) -> int:
    """0, or 2 if a name is none of a part."""
    if unknown := [name for name in names if name not in PARTS]:
        print(f'no part "{unknown[0]}"; there are {", ".join(PARTS)}', file=sys.stderr)
        return 2
    data = making.data_folder()
    parts = json.loads(FIGURES.read_text(encoding="utf-8")) if names and FIGURES.exists() else {}
    for name in names or PARTS:
        parts[name] = PARTS[name](folder / name, data, jobs)
        parts = {each: parts[each] for each in PARTS if each in parts}
        write_whole(FIGURES, (json.dumps(parts, indent=1, ensure_ascii=False) + "\n").encode())
        write_whole(PAGE, page(parts).encode())
    return 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="PART")
    parser.add_argument("--folder", type=Path, default=Path("build/peers"))
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    sys.exit(main(given.names, given.folder.resolve(), given.jobs))
