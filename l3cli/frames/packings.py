"""Packings of headerless raw frames. A packing defines how pixel bits are arranged in the bytes of a file.

The packings are defined in MIPI CSI-2 (RAW10, RAW12), GenICam Pixel Format Naming Convention (PFNC) 2.4, and GigE Vision 2
(formats "…Packed"). PFNC has no names for polarisation cameras. Teledyne FLIR ("Polarized8", "BayerRGPolarized12p") and
Lucid ("PolarizeMono8", "PolarizedAngles_0d_45d_90d_135d_Mono8") use their own names with PFNC bit layouts.

The option help, error messages and the table in docs/raw-files.md are generated from `PACKINGS`.
"""

from dataclasses import dataclass
from typing import NamedTuple

from l3cli.errors import shortened, suggestion

BAYER_ORDERS = ("GR", "RG", "GB", "BG")  # colours of the first two pixels of the first row
SECOND_ROWS = {"GR": "BG", "RG": "GB", "GB": "RG", "BG": "GR"}
FAMILIES = {
    "words": "one pixel per byte, or one pixel in the lower bits of each 16-bit word",
    "mipi": (
        "MIPI CSI-2: the upper bytes of a group of pixels, then one byte with the lower bits of all pixels in the group; "
        "the last group of a row is always complete"
    ),
    "p": "PFNC: a stream of bits, lower bits first",
    "pmsb": "PFNC: a stream of bits, upper bits first",
    "Packed": "GigE Vision: two pixels in three bytes; the middle byte contains the lower bits of both pixels",
}
CELL = ((1, 1), (0, 1), (0, 0), (1, 0))  # (row, col) of the polarisers at 0°, 45°, 90° and 135° in a cell of 2×2 pixels
COMPUTED = ("PolarizedStokes", "PolarizedDolp", "PolarizedAolp")  # prefixes of formats that do not contain raw values


class Piece(NamedTuple):
    """Adjacent bits of a pixel that are stored in one byte of a group (see `Packing`)."""

    byte: int  # index of the byte in the group
    shift: int  # position of the lowest bit in the byte
    bits: int
    place: int  # position of the lowest bit in the pixel


@dataclass(frozen=True)
class Packing:
    """How pixel bits are stored in bytes.

    The layout repeats after each group, a fixed number of pixels in a fixed number of bytes.
    """

    name: str
    family: str  # one of FAMILIES
    bits: int  # bits per pixel
    group_bytes: int
    pieces: tuple[tuple[Piece, ...], ...]  # pieces of each pixel in a group
    pattern: str = ""  # 2×2 CFA at the first pixel, such as "rggb"; "" if the packing implies no CFA
    polarised: bool = False  # whether only polarisation cameras use this name
    cells: bool = False  # whether the four pixels of each 2×2 cell are stored consecutively, in the order of CELL

    @property
    def group_pixels(self) -> int:
        """Number of pixels in a group."""
        return len(self.pieces)

    @property
    def is_words(self) -> bool:
        """Whether each pixel is a 16-bit word, for which the user may set the byte order."""
        return self.family == "words" and self.group_bytes == 2

    def bytes_of(self, pixels: int) -> int:
        """Return the number of bytes in a row of `pixels` pixels. In MIPI packings, the last group is always complete."""
        if self.family == "mipi":
            return -(-pixels // self.group_pixels) * self.group_bytes
        return -(-pixels * self.group_bytes * 8 // (8 * self.group_pixels))


def _stream(bits: int, lower_first: bool) -> tuple[int, tuple[tuple[Piece, ...], ...]]:
    """Return the layout of pixels that are packed without gaps: bytes per group, and pieces of each pixel.

    A group is the smallest number of pixels that fills a whole number of bytes. If `lower_first` is True, the lower bits of
    a pixel are stored first.
    """
    pixels = next(count for count in (1, 2, 4, 8) if count * bits % 8 == 0)
    groups = []
    for first in range(0, pixels * bits, bits):
        pieces, done = [], 0
        while done < bits:
            byte, used = divmod(first + done, 8)
            count = min(8 - used, bits - done)
            if lower_first:
                pieces.append(Piece(byte, used, count, done))
            else:
                pieces.append(Piece(byte, 8 - used - count, count, bits - done - count))
            done += count
        groups.append(tuple(pieces))
    return pixels * bits // 8, tuple(groups)


def _mipi(bits: int) -> tuple[int, tuple[tuple[Piece, ...], ...]]:
    """Return the layout of a MIPI packing: bytes per group, and pieces of each pixel.

    A group contains one byte per pixel with its upper 8 bits, followed by one byte with the lower bits of all pixels. The
    first pixel is in the lowest bits of this byte.
    """
    low = bits - 8
    pixels = 8 // low
    return pixels + 1, tuple((Piece(i, 0, 8, low), Piece(pixels, i * low, low, 0)) for i in range(pixels))


def _gige(bits: int) -> tuple[int, tuple[tuple[Piece, ...], ...]]:
    """Return the layout of a GigE Vision packing: bytes per group, and pieces of each pixel.

    A group contains two pixels in three bytes. The first and the last byte contain the upper 8 bits of the first and of the
    second pixel. The middle byte contains the lower bits of both pixels: the first pixel's from bit 0, the second's from bit
    4.
    """
    low = bits - 8
    return 3, ((Piece(0, 0, 8, low), Piece(1, 0, low, 0)), (Piece(2, 0, 8, low), Piece(1, 4, low, 0)))


def _word(bytes_of_pixel: int) -> tuple[int, tuple[tuple[Piece, ...], ...]]:
    return bytes_of_pixel, (tuple(Piece(byte, 0, 8, 8 * byte) for byte in range(bytes_of_pixel)),)


POLARISED = (  # (prefixes, suffixes) of packing names for polarisation cameras; any prefix can be combined with any suffix
    (("Polarized", "BayerRGPolarized"), ("8", "10p", "12p", "16")),
    (("PolarizeMono",), ("8", "12", "12p", "12Packed", "16")),
    (("PolarizedAngles_0d_45d_90d_135d_Mono", "PolarizedAngles_0d_45d_90d_135d_BayerRG"), ("8", "12p", "16")),
)


def _packings() -> dict[str, Packing]:
    plain = [Packing(f"u{bits}", "words", bits, *_word(bits // 8)) for bits in (16, 8)]
    plain += [Packing(f"raw{bits}", "mipi", bits, *_mipi(bits)) for bits in (10, 12)]
    endings = [(str(bits), "words", bits, _word(1 if bits == 8 else 2)) for bits in (8, 10, 12, 14, 16)]
    endings += [(f"{bits}p", "p", bits, _stream(bits, True)) for bits in (10, 12, 14)]
    endings += [(f"{bits}pmsb", "pmsb", bits, _stream(bits, False)) for bits in (10, 12, 14)]
    endings += [(f"{bits}Packed", "Packed", bits, _gige(bits)) for bits in (10, 12)]
    layouts = {end: (family, bits, layout) for end, family, bits, layout in endings}
    polarised = [
        Packing(start + end, family, bits, *layout, polarised=True, cells=start.startswith("PolarizedAngles"))
        for starts, ends in POLARISED
        for start in starts
        for end in ends
        for family, bits, layout in (layouts[end],)
    ]
    patterns = {"Mono": ""} | {f"Bayer{first}": (first + SECOND_ROWS[first]).lower() for first in BAYER_ORDERS}
    named = [
        Packing(start + end, family, bits, *layout, pattern)
        for start, pattern in patterns.items()
        for end, family, bits, layout in endings
    ]
    return {packing.name: packing for packing in (*plain, *named, *polarised)}


PACKINGS = _packings()
WORDS = "u16"


def packing_named(name: str) -> Packing | None:
    """Return the packing with a name, ignoring case, or None if the name is unknown.

    "Mono" may be omitted, as in "12p" for "Mono12p".
    """
    known = {each.lower(): packing for each, packing in PACKINGS.items()}
    return known.get(name.lower()) or (known.get(f"mono{name.lower()}") if not name.isdigit() else None)


def unknown_packing(name: str) -> str:
    """Return an error message for an unknown packing. The message starts with the name in quotes."""
    if name.lower().startswith(tuple(map(str.lower, COMPUTED))):
        return (
            f'"{shortened(name)}" is a format for values that the camera computed from its raw values; record raw frames in '
            "a format such as PolarizeMono12p or Mono12p"
        )
    return f'"{shortened(name)}" is unknown; {suggestion(name, PACKINGS)}'
