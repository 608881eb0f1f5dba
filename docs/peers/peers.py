"""Compare l3 with other methods and write docs/peers.md.

    python docs/peers/peers.py [PART …] [--folder DIR] [--seconds | --ours]

Without arguments, all parts are measured. The page states the date, the computer and the source digest of each part.
Training sets and tables are stored in the folder (build/peers) and reused. If a table was trained with another source, the
page says so. If parts are named, the other parts in figures.json are kept. With --ours, the results of the rivals are kept.
"""

import argparse
import functools
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cbm3d
import libraw_rivals
import making
import network
import polarisation_rivals
import provenance
import rawtherapee
from judging import (
    OURS,
    Protocol,
    band_protocol,
    best_first,
    code_protocol,
    described,
    judged,
    picture_protocol,
    put_seconds,
    stokes_protocol,
)
from peers_page import Part, page
from rivals import PLAIN, Demosaic, Rival, gathered, installed
from seconds import core_seconds

from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.evaluation.demosaic import bilinear, interpolate, malvar, menon, ppi_difference, spectral_difference
from l3cli.system.files import write_whole

FOLDER = Path(__file__).parent
FIGURES, PAGE = FOLDER / "figures.json", FOLDER.parent / "peers.md"
Programs = list[Callable[[], list[Rival]]]
OUR_METHODS = "l3's own"  # published methods in l3 or in this folder


@dataclass(frozen=True)
class Comparison:
    """The training sets, tables, rivals and metrics of one part of the page."""

    sets: Mapping[str, Path]
    tables: Mapping[str, Path]
    rivals: Sequence[Rival]
    protocol: Protocol
    missing: Sequence[str] = ()  # programs that are not installed
    absent: Sequence[str] = ()  # picture sets that are missing

    def measured(self) -> Part:
        """Measure the part. Return the entry for figures.json, without the run."""
        rows = judged(self.sets, self._loaded(), self.rivals, self.protocol)
        trained = {name: provenance.stamped(path) for name, path in self.tables.items()}
        return {
            "trained": trained,
            **described(self.sets),
            "rows": rows,
            "missing": list(self.missing),
            "absent": list(self.absent),
        }

    def renewed(self, part: Part) -> Part:
        """Measure only the tables again, and keep the results of the rivals and all times.

        Raises SystemExit if the rivals were measured on other frames.
        """
        ours = replace(self, rivals=(), missing=part["missing"]).measured()
        if ours["digest"] != part.get("digest"):
            raise SystemExit("the rivals were measured on other frames; measure them again, without --ours")
        before, rivals = ([row for row in part["rows"] if row["ours"] == of] for of in (True, False))
        seconds = {row["name"]: {"seconds": row["seconds"]} for row in before if "seconds" in row}
        rows = [row | seconds.get(row["name"], {}) for row in ours["rows"]]
        run = part.get("rivals", part["run"])
        return ours | {"rows": best_first(rows + rivals), "rivals": run, "timed": part.get("timed", run)}

    def timed(self, part: Part) -> Part:
        """Measure only the times again. Rows of methods that are not installed keep their times."""
        known = {(rival.name, rival.program) for rival in self.rivals} | {(name, OURS) for name in self.tables}
        rows = [row | {"seconds": 0.0} for row in part["rows"] if (row["name"], row["program"]) in known]
        put_seconds(rows, self.sets, self._loaded(), self.rivals)
        again = {(row["name"], row["program"]): row for row in rows}
        return part | {"rows": [again.get((row["name"], row["program"]), row) for row in part["rows"]]}

    def _loaded(self) -> dict[str, TransformTable]:
        return {name: load(TransformTable, path) for name, path in self.tables.items()}


def bayer(folder: Path, data: Path, jobs: int) -> Comparison:
    sets, table = making.codes(folder, data, "bayer", jobs)
    programs: Programs = [_plain_bayer, _colour_demosaicing, functools.partial(libraw_rivals.bayer, False)]
    programs += [functools.partial(rawtherapee.bayer, False), functools.partial(network.rivals, (2, 2), False)]
    return Comparison(sets, {"benchmark-bayer": table}, *_rivals(programs, code_protocol()), _absent(sets))


def xtrans(folder: Path, data: Path, jobs: int) -> Comparison:
    sets, table = making.codes(folder, data, "xtrans", jobs)
    own = [Rival("bilinear", OUR_METHODS, {PLAIN: interpolate})]
    programs: Programs = [lambda: own, libraw_rivals.xtrans, rawtherapee.xtrans]
    programs.append(functools.partial(network.rivals, (6, 6), False))
    return Comparison(
        sets, {"benchmark-bayer, its array X-Trans": table}, *_rivals(programs, code_protocol()), _absent(sets)
    )


def bands(folder: Path, data: Path, jobs: int) -> Comparison:
    sets, table = making.bands(folder, data, jobs)
    methods = {"weighted bilinear": bilinear, "spectral difference": spectral_difference, "PPID": ppi_difference}
    rivals = [Rival(name, OUR_METHODS, {PLAIN: demosaic}) for name, demosaic in methods.items()]
    return Comparison(sets, {"bands": table}, rivals, band_protocol())


def noise(folder: Path, data: Path, jobs: int) -> Comparison:
    sets, tables = making.noise(folder, data, jobs)
    programs: Programs = [_plain_bayer, _colour_demosaicing, functools.partial(libraw_rivals.bayer, True)]
    programs += [functools.partial(rawtherapee.bayer, True), functools.partial(network.rivals, (2, 2), True), cbm3d.bayer]
    return Comparison(sets, tables, *_rivals(programs, picture_protocol()))


def polarisation(folder: Path, data: Path, jobs: int) -> Comparison:
    sets, table = making.polarisation(folder, data, jobs)
    lmmse = polarisation_rivals.trained_on_other_scenes(sets.values())
    methods: dict[str, Demosaic] = {
        "bilinear": bilinear,
        "Newton": polarisation_rivals.newton,
        "IGRI": polarisation_rivals.igri,
        "LMMSE": lmmse,
    }
    rivals = [Rival(name, OUR_METHODS, {PLAIN: demosaic}) for name, demosaic in methods.items()]
    return Comparison(sets, {"polarised": table}, rivals, stokes_protocol())


PARTS: dict[str, Callable[[Path, Path, int], Comparison]] = {
    "bayer": bayer,
    "xtrans": xtrans,
    "bands": bands,
    "noise": noise,
    "polarisation": polarisation,
}


def _rivals(programs: Programs, protocol: Protocol) -> tuple[list[Rival], Protocol, list[str]]:
    rivals, missing = gathered(programs)
    return rivals, protocol, missing


def _absent(sets: Mapping[str, Path]) -> list[str]:
    return [name for name in making.PICTURES if name not in sets]


def _plain_bayer() -> list[Rival]:
    return [Rival("bilinear", OUR_METHODS, {PLAIN: bilinear})]


def _colour_demosaicing() -> list[Rival]:
    program = installed("colour-demosaicing")
    methods: dict[str, Demosaic] = {"Malvar": malvar, "Menon": menon}
    return [Rival(name, program, {PLAIN: demosaic}) for name, demosaic in methods.items()]


def main(names: list[str], folder: Path, jobs: int, seconds: bool = False, ours: bool = False) -> int:
    """Return 0, or 2 if a name is not the name of a part.

    If `seconds`, only times are measured again. If `ours`, only the tables of l3 are measured again.
    """
    if unknown := [name for name in names if name not in PARTS]:
        print(f'no part "{unknown[0]}"; there are {", ".join(PARTS)}', file=sys.stderr)
        return 2
    data = making.data_folder()
    run = provenance.origin()
    partial = (names or seconds or ours) and FIGURES.exists()
    parts = json.loads(FIGURES.read_text(encoding="utf-8")) if partial else {}
    for name in names or (parts if seconds or ours else PARTS):
        start = core_seconds()
        compared = PARTS[name](folder / name, data, jobs)
        if seconds:
            parts[name] = compared.timed(parts[name]) | {"timed": run}
        elif ours:
            parts[name] = {"run": run} | compared.renewed(parts[name])
        else:
            parts[name] = {"run": run} | compared.measured()
        parts = {each: parts[each] for each in PARTS if each in parts}
        write_whole(FIGURES, (json.dumps(parts, indent=1, ensure_ascii=False) + "\n").encode())
        write_whole(PAGE, page(parts).encode())
        print(f"{name}: {(core_seconds() - start) / 60:.0f} minutes of processor time", file=sys.stderr, flush=True)
    return 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="PART")
    parser.add_argument("--folder", type=Path, default=Path("build/peers"))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--seconds", action="store_true", help="measure only the times again")
    parser.add_argument("--ours", action="store_true", help="measure only the tables of l3 again")
    given = parser.parse_args()
    sys.exit(main(given.names, given.folder.resolve(), given.jobs, given.seconds, given.ours))
