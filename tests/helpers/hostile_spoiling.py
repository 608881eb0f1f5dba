"""Functions that corrupt files: bytes, words of a text, and members of HDF5 files.

Choices come from Hypothesis (test_hostile.py) or from a seed (fuzz.py).
"""

import io
import re
from typing import Any, Protocol

import h5py
import numpy as np

LARGEST_SPOILT = 1 << 20  # values; single values are replaced only in smaller datasets


class Choices(Protocol):
    """Source of random choices."""

    def integer(self, least: int, most: int) -> int:
        """Draw an integer from `least` to `most`, inclusive."""


def one_of(choices: Choices, options: Any) -> Any:
    return options[choices.integer(0, len(options) - 1)]


INTEGERS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 2**62, 2**63, 2**64 - 1, 255, 16)
WHOLE = (0, -1, 1, 2, 3, 7, 16, 2**31 - 1, 2**32, 2**63 - 1, 2**63, -(2**63), 10**9, 10**40)  # none causes long work
BROKEN = (1e30, 1e-30, 1e300, 1e-300, -1e300, 0.5, -0.5, 1.0000001, 1e9, 1e20, -3.5, 1e-9, float("nan"), float("inf"))
NUMBERS = (*map(str, WHOLE), *map(str, BROKEN), "-inf", "1_000", "0x10", "[]", "[1]", "[1, 2, 3, 4, 5]", "true", "{}")
TEXTS = (
    '""', '"."', '".."', '"../../../etc/passwd"', '"/etc/passwd"', '"/dev/zero"', '"/dev/stdin"', '"\\u0000"', '"*"', '"["',
    '"a/../../b"', '"$(touch hurt)"', '"`touch hurt`"', '"; touch hurt"', '"<script>"', '"\\u001b[31m"', '"%s%n"', '"~"',
    '"D65"',
    '"scene"', '"1e9K"', '"0K"', '"D4000K"', '"-1 D65 + 2 A"', '"camera"', '"r"', '"r r"', '"none.csv"', '"picture.png"',
    '"lamp.csv"', '"frame.tif"', '"scenes.toml"', f'"{"x" * 5000}"', "'''\n'''", '"row row row"', '"é\\u202e"', "[]",
    '["a"]', "{}",
)  # fmt: skip
WORDS = re.compile(r"""("[^"\n]*"|[-+]?\d[\d.eE+-]*|\btrue\b|\bfalse\b|[A-Za-z_]\w*)""")


def spoiled_bytes(content: bytes, choices: Choices) -> bytes:
    """Change, remove or repeat some bytes of a file, or cut it off."""
    spoilt = bytearray(content)
    for _ in range(choices.integer(1, 4)):
        if not spoilt:
            break
        reach = min(len(spoilt), one_of(choices, (64, 512, len(spoilt))))  # headers are at the beginning
        at = choices.integer(0, reach - 1)
        if choices.integer(0, 7) == 0:
            at = len(spoilt) - 1 - at  # or at the end
        kind = choices.integer(0, 7)
        if kind <= 1:
            spoilt[at] ^= 1 << choices.integer(0, 7)
        elif kind == 2:
            spoilt[at] = choices.integer(0, 255)
        elif kind <= 4:
            width = one_of(choices, (2, 4, 8))
            number = one_of(choices, INTEGERS) % 2 ** (8 * width)
            spoilt[at : at + width] = number.to_bytes(width, one_of(choices, ("little", "big")))
        elif kind == 5:
            del spoilt[at : at + choices.integer(1, 64)]
        elif kind == 6:
            length = choices.integer(1, 64)
            spoilt[at:at] = spoilt[at : at + length] * choices.integer(1, 4)
        else:
            del spoilt[at:]
    return bytes(spoilt)


def spoiled_text(content: bytes, choices: Choices) -> bytes:
    """Replace some words of a text by harmful ones, and remove or repeat some lines. Occasionally change bytes as well."""
    if choices.integer(0, 15) == 0:
        return spoiled_bytes(content, choices)
    text = content.decode()
    for _ in range(choices.integer(1, 3)):
        words = list(WORDS.finditer(text))
        change = choices.integer(0, 9)
        if change <= 7 and words:
            word = one_of(choices, words)
            with_quotes = word[0].startswith('"')
            kind = (TEXTS if with_quotes else NUMBERS) if choices.integer(0, 7) else TEXTS + NUMBERS
            new = one_of(choices, kind)
            text = text[: word.start()] + new + text[word.end() :]
        else:
            lines = text.split("\n")
            at = choices.integer(0, len(lines) - 1)
            lines[at : at + 1] = [] if change == 8 else [lines[at]] * choices.integer(2, 5)
            text = "\n".join(lines)
    return text.encode()


def spoiled_hdf5(content: bytes, choices: Choices) -> bytes:
    """Replace some members or values of an HDF5 file by ones that l3 never writes. Occasionally change bytes as well."""
    if choices.integer(0, 2) == 0:
        return spoiled_bytes(content, choices)
    return _spoiled_members(content, choices, "")


def spoiled_layer(content: bytes, choices: Choices) -> bytes:
    """Replace some members or values of a table's second layer by ones that l3 never writes."""
    return _spoiled_members(content, choices, "later/0")


def _spoiled_members(content: bytes, choices: Choices, below: str) -> bytes:
    image = io.BytesIO(content)
    with h5py.File(image, "r+") as root:
        for _ in range(choices.integer(1, 2)):
            names: list[str] = []
            root.visit(names.append)
            names = [name for name in names if name.startswith(below)]
            if names:
                _spoil_member(root, one_of(choices, names), choices)
    return image.getvalue()


def _spoil_member(root: h5py.File, name: str, choices: Choices) -> None:
    member = root[name]
    if not isinstance(member, h5py.Dataset) or member.size > LARGEST_SPOILT or choices.integer(0, 3) == 0:
        kind = choices.integer(0, 7)
        if kind >= 6:
            holder = root if kind == 6 else member
            holder.attrs[one_of(choices, ("kind", "version", "axes"))] = one_of(
                choices,
                (0, -1, 99, 2**62, "camera model", "x" * 1000, np.arange(5), np.bytes_(b"\xff"), h5py.Empty("f"), np.nan),
            )
            return
        del root[name]
        if kind == 1:
            root[name] = h5py.SoftLink("/")
        elif kind == 2:
            root[name] = h5py.ExternalLink("/etc/passwd", "/")
        elif kind == 3:
            root[name] = root  # a cycle
        elif kind == 4:
            root.create_group(name)
        elif kind == 5:
            root.create_dataset(name, (2**20, 2**20), "f8", chunks=(64, 64), compression="gzip")
        return
    values = member[()]
    if choices.integer(0, 1) or member.dtype.kind not in "biuf":
        del root[name]
        root[name] = _other_values(values, choices)
    else:
        array = np.array(values)
        if array.size:
            flat = array.reshape(-1)
            flat[choices.integer(0, array.size - 1)] = _hurtful(array.dtype, choices)
        member[()] = array


def _hurtful(dtype: np.dtype, choices: Choices) -> Any:
    if dtype.kind in "SO":
        return one_of(choices, (b"", b"X", b"\xff\xfe", b"[]", b"{}", b'[{"command": 1}]', b"../../x", b"\x1b[31m<script>"))
    if dtype.kind == "f":
        return one_of(choices, (0.0, -1.0, 1e-300, 1e30, -1e30, np.nan, np.inf, 0.5, 1e6))
    if dtype.kind == "b":
        return bool(choices.integer(0, 1))
    if dtype.kind not in "iu":
        return 0
    limits = np.iinfo(dtype)
    return one_of(choices, (0, 1, limits.max, limits.min, 2, 3, 16, 100))


def _other_values(values: Any, choices: Choices) -> Any:
    array = np.asarray(values)
    kind = choices.integer(0, 6)
    if kind == 0:
        return np.asarray(array.reshape(-1)[: choices.integer(0, 2)])
    if kind == 1:
        return np.repeat(np.atleast_1d(array), 2, axis=0)
    if kind == 2:
        return array[None]
    if kind == 3:
        return np.zeros(array.shape, one_of(choices, ("u1", "i8", "f8", "f4", "S3", "c16", "?")))
    if kind == 4:
        return one_of(choices, ("text", b"\xff", 5, 2**60, 1.5, np.nan, True))
    if kind == 5:
        return np.full(array.shape, _hurtful(array.dtype, choices), array.dtype)
    return np.zeros((0,) * array.ndim, array.dtype if array.dtype.kind != "O" else "f8")
