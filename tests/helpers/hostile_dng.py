"""DNG files with tags that change pixel values, stored in every way that the tags describe and in some unsupported ways.

l3 must read the original mosaic from the file, or refuse the file with one line. l3 may refuse only files with a tag that
l3 does not support.
"""

import shutil
from dataclasses import dataclass

import numpy as np

from l3cli.errors import InputFileError
from l3cli.io.raw.files import read_raw
from l3cli.physics.mosaic import shifted_cfa
from tests.helpers.cameras import BAYER
from tests.helpers.dng_files import BYTE, LONG, SHORT, Tags, lossless_jpeg, packed, write_dng
from tests.helpers.hostile import Workshop
from tests.helpers.hostile_spoiling import Choices, one_of
from tests.helpers.raw_files import RGGB

PATTERN = np.array(BAYER)
ODD = {  # tag: (type, unsupported values); if the tag has several values, one of them is replaced
    254: (LONG, (1, 4, 8, 16, 65536)), 259: (SHORT, (8, 34892, 52546, 99)), 266: (SHORT, (2, 0)), 277: (SHORT, (3, 4)),
    274: (SHORT, (9, 255, 65535)), 317: (SHORT, (2, 3)), 339: (SHORT, (2, 3, 4)), 50707: (BYTE, (2, 9)),
    50711: (SHORT, (2, 5, 9)), 50879: (SHORT, (1, 2)), 50974: (LONG, (0, 2, 4)), 50975: (LONG, (0,)), 52547: (LONG, (0,)),
    50829: (LONG, (0, 1000)), 50720: (LONG, (0, 1000)),
}  # fmt: skip
COUNT = {50707: 4, 50974: 2, 50829: 4, 50720: 2}  # number of values of a tag; other tags have one


@dataclass(frozen=True)
class Trial:
    """A mosaic and the way in which it is stored."""

    seed: int
    shape: tuple[int, int]
    bits: int
    order: str
    fields: tuple[int, int]
    layout: str
    length: int  # rows per strip or tile
    width: int  # columns per tile
    active: tuple[int, int, int, int]
    crop: tuple[int, int, int, int]  # row, column, rows, columns
    orientation: int
    odd: tuple[int, int] | None  # a tag and its value

    @property
    def may_be_refused(self) -> bool:
        """Whether LibRaw may be unable to read the file."""
        return self.odd is not None or (self.layout.endswith("tiles") and self.width > self.shape[1])


@dataclass(frozen=True)
class DngTags:
    """Draws random trials and checks how l3 reads them."""

    name: str = "DNG tags that change pixels"
    often: int = 3

    def draw(self, choices: Choices) -> Trial:
        """Draw a trial."""
        rows, cols = choices.integer(36, 60), choices.integer(36, 60)  # LibRaw needs an active area of at least 22
        layout = one_of(choices, ("strip", "strips", "tiles", "jpeg", "jpeg tiles"))
        top, left = choices.integer(0, 5), choices.integer(0, 5)
        bottom, right = choices.integer(rows - 5, rows), choices.integer(cols - 5, cols)
        row, col = choices.integer(0, 4), choices.integer(0, 4)
        tag = one_of(choices, list(ODD))
        return Trial(
            seed=choices.integer(0, 2**32 - 1),
            shape=(rows, cols),
            bits=16 if layout.startswith("jpeg") else one_of(choices, (8, 10, 12, 14, 16)),
            order=one_of(choices, "<>"),
            fields=(choices.integer(1, 4), choices.integer(1, 4)),
            layout=layout,
            length=16 * choices.integer(1, 5),
            width=16 * choices.integer(1, 5),
            active=(top, left, bottom, right),
            crop=(row, col, choices.integer(1, bottom - top - row), choices.integer(1, right - left - col)),
            orientation=choices.integer(0, 8),
            odd=(tag, one_of(choices, ODD[tag][1])) if choices.integer(0, 2) == 0 else None,
        )

    def judge(self, shop: Workshop, trial: Trial) -> str | None:
        """Return what went wrong, or None."""
        out = shop.folder / "out"
        out.mkdir()
        values = np.random.default_rng(trial.seed).integers(0, 2**trial.bits, trial.shape).astype(np.uint16)
        strips, tags = _stored(trial, values)
        write_dng(out / "a.dng", values, PATTERN, trial.bits, trial.order, strips, tags=tags)
        top, left, bottom, right = trial.active
        row, col, rows, cols = trial.crop
        try:
            frame = read_raw(out / "a.dng", RGGB)
        except InputFileError as error:
            words = str(error)
            return None if trial.may_be_refused and "a.dng" in words and "\n" not in words else f"refused: {words}"
        finally:
            shutil.rmtree(out)
        if trial.odd is not None:
            return "read in spite of a tag that is not"
        if not np.array_equal(frame.values, values[top:bottom, left:right][row : row + rows, col : col + cols]):
            return "other pixels than those that were stored"
        if not np.array_equal(shifted_cfa(RGGB.cfa, frame.phase), np.roll(PATTERN, (-row, -col), (0, 1))):
            return f"another phase, {frame.phase}"
        return None


def _stored(trial: Trial, values: np.ndarray) -> tuple[list[bytes], Tags]:
    """Return the strips or tiles, and the tags that describe them."""
    for axis, count in enumerate(trial.fields):
        order = [index for field in range(count) for index in range(field, trial.shape[axis], count)]
        values = values.take(order, axis)
    tags: Tags = {
        274: (SHORT, [trial.orientation]),
        50714: (SHORT, [7]),
        50717: (LONG, [200]),
        50719: (LONG, [trial.crop[1], trial.crop[0]]),
        50720: (LONG, [trial.crop[3], trial.crop[2]]),
        50829: (LONG, list(trial.active)),
        50975: (LONG, [trial.fields[0]]),
        52547: (LONG, [trial.fields[1]]),
    }
    jpeg, tiled = trial.layout.startswith("jpeg"), trial.layout.endswith("tiles")
    rows, cols = trial.shape
    length = min(trial.length, rows) if trial.layout == "strips" else trial.length if tiled else rows
    width = trial.width if tiled else cols
    whole = np.pad(values, ((0, -rows % length if tiled else 0), (0, -cols % width)))
    parts = [whole[r : r + length, c : c + width] for r in range(0, rows, length) for c in range(0, cols, width)]
    strips = [lossless_jpeg(part) if jpeg else packed(part, trial.bits, trial.order) for part in parts]
    tags[259] = SHORT, [7 if jpeg else 1]
    if tiled:
        sizes = [len(strip) for strip in strips]
        tags |= {322: (LONG, [width]), 323: (LONG, [length]), 324: (LONG, [0] * len(sizes)), 325: (LONG, sizes)}
    else:
        tags[278] = LONG, [length]
    if trial.odd is not None:
        code, value = trial.odd
        tags[code] = ODD[code][0], [value] * COUNT.get(code, 1)
    return strips, tags
