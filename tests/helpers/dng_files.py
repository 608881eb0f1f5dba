"""DNG files in packings and compressions that cameras and converters write but l3 does not."""

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np

BYTE, ASCII, SHORT, LONG, RATIONAL, UNDEFINED, SRATIONAL = 1, 2, 3, 4, 5, 7, 10
LETTER = {BYTE: "B", ASCII: "B", UNDEFINED: "B", SHORT: "H", LONG: "I", RATIONAL: "I", SRATIONAL: "i"}
WORDS = (RATIONAL, SRATIONAL)
Tags = dict[int, tuple[int, list[int]]]


def packed(values: np.ndarray, bits: int, order: str) -> bytes:
    """Pack rows of values with `bits` bits each, most significant bit first. Whole bytes and words are stored as in TIFF."""
    if bits in (8, 16):
        return values.astype(f"{order}u{bits // 8}").tobytes()
    ones = (values[..., None] >> np.arange(bits - 1, -1, -1, dtype=np.uint16)) & 1
    return np.packbits(ones.reshape(len(values), -1).astype(np.uint8), axis=1).tobytes()


def lossless_jpeg(values: np.ndarray, components: int = 1, predictor: int = 1, bits: int = 16) -> bytes:
    """Encode values as lossless JPEG (ITU-T T.81, process 14) with `components` values per pixel.

    Small differences have codes of 2 bits, other differences have codes of 6 bits.
    """
    rows, cols = values.shape
    wanted = values.astype(np.int64)
    left, above, beyond = (np.roll(wanted, by, (0, 1)) for by in ((0, components), (1, 0), (1, components)))
    guesses = [left, above, beyond, left + above - beyond, left + (above - beyond >> 1), above + (left - beyond >> 1)]
    before = [*guesses, left + above >> 1][predictor - 1]
    before[0], before[1:, :components] = left[0], above[1:, :components]
    before[0, :components] = 1 << bits - 1
    codes = [f"{size:02b}" if size < 3 else f"{48 + size - 3:06b}" for size in range(17)]
    text = []
    for difference in (((wanted - before + 32768) % 65536) - 32768).ravel().tolist():
        size = abs(difference).bit_length()
        rest = difference if difference > 0 else difference + (1 << size) - 1
        text.append(codes[size] + (f"{rest:0{size}b}" if 0 < size < 16 else ""))
    joined = "".join(text)
    joined += "1" * (-len(joined) % 8)
    scan = int(joined, 2).to_bytes(len(joined) // 8, "big").replace(b"\xff", b"\xff\0")
    numbers = range(components)
    frame = struct.pack(">BHHB", bits, rows, cols // components, components) + b"".join(bytes([n, 0x11, 0]) for n in numbers)
    table = bytes([0, 0, 3, 0, 0, 0, 14]) + bytes(10) + bytes(range(17))
    start = bytes([components, *(each for n in numbers for each in (n, 0)), predictor, 0, 0])
    segments = ((0xC3, frame), (0xC4, table), (0xDA, start))
    head = b"".join(struct.pack(">BBH", 0xFF, kind, len(body) + 2) + body for kind, body in segments)
    return b"\xff\xd8" + head + scan + b"\xff\xd9"


def write_dng(
    path: Path, values: np.ndarray, pattern: np.ndarray, bits: int = 16, order: str = "<",
    strips: list[bytes] | None = None, gap: int = 0, tags: Tags | None = None, drop: Sequence[int] = (),
) -> Path:  # fmt: skip
    """Write values (row, col) as a DNG file whose CFA pattern has the codes `pattern`.

    `tags` are added to the tags that a DNG needs or replace them, and tags in `drop` are omitted. Strips are `gap` bytes
    apart.
    """
    rows, cols = values.shape
    strips = strips or [packed(values, bits, order)]
    base: Tags = {
        254: (LONG, [0]), 256: (LONG, [cols]), 257: (LONG, [rows]), 258: (SHORT, [bits]), 259: (SHORT, [1]),
        262: (SHORT, [32803]), 273: (LONG, [0] * len(strips)), 274: (SHORT, [1]), 277: (SHORT, [1]),
        278: (LONG, [-(-rows // len(strips))]), 279: (LONG, [len(strip) for strip in strips]), 284: (SHORT, [1]),
        33421: (SHORT, list(pattern.shape)), 33422: (BYTE, pattern.ravel().tolist()), 50706: (BYTE, [1, 4, 0, 0]),
        50708: (BYTE, list(b"some camera\0")), 50710: (BYTE, np.unique(pattern).tolist()), 50714: (SHORT, [64]),
        50717: (LONG, [4000]),
    }  # fmt: skip
    base |= tags or {}
    base = {code: base[code] for code in sorted(base) if code not in drop}
    offsets_at = 324 if 324 in base else 273  # of tiles or strips
    start = 8 + 2 + 12 * len(base) + 4
    start += sum(len(_words(order, *tag)) + 1 for tag in base.values())
    starts = start + np.cumsum([0] + [len(strip) + gap for strip in strips[:-1]])
    base[offsets_at] = (LONG, starts.tolist())
    entries, rest = [], b""
    for code, (kind, numbers) in base.items():
        words = _words(order, kind, numbers)
        count = len(numbers) // (2 if kind in WORDS else 1)
        place = struct.pack(order + "I", 8 + 2 + 12 * len(base) + 4 + len(rest))
        entries.append(struct.pack(order + "HHI", code, kind, count) + (words.ljust(4, b"\0") if len(words) <= 4 else place))
        rest += words + b"\0" * (len(words) % 2) if len(words) > 4 else b""
    head = (b"II" if order == "<" else b"MM") + struct.pack(order + "HIH", 42, 8, len(base))
    content = head + b"".join(entries) + struct.pack(order + "I", 0) + rest
    path.write_bytes(content.ljust(start, b"\0") + (b"\0" * gap).join(strips))
    return path


def opcode_list(*opcodes: tuple[int, int, bytes]) -> tuple[int, list[int]]:
    """Encode an opcode list from the number, flags and content of each opcode."""
    entries = [struct.pack(">IIII", number, 0x01030000, flags, len(content)) + content for number, flags, content in opcodes]
    return UNDEFINED, list(struct.pack(">I", len(opcodes)) + b"".join(entries))


def gain_map(
    gains: np.ndarray, area: tuple[int, ...], plane: tuple[int, int] = (0, 1), pitch: tuple[int, int] = (1, 1)
) -> bytes:
    """Encode a GainMap opcode.

    The gains (row, col[, plane]) extend from edge to edge of `area` (top, left, bottom, right).
    """
    gains = gains.reshape(*gains.shape[:2], -1)
    rows, cols, planes = gains.shape
    spacing = [1 / max(rows - 1, 1), 1 / max(cols - 1, 1)]
    head = struct.pack(">8I", *area, *plane, *pitch) + struct.pack(">2I4dI", rows, cols, *spacing, 0.0, 0.0, planes)
    return head + gains.astype(">f4").tobytes()


def _words(order: str, kind: int, numbers: list[int]) -> bytes:
    return struct.pack(f"{order}{len(numbers)}{LETTER[kind]}", *numbers)
