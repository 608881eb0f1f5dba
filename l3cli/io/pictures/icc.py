"""Create ICC display profiles for colour spaces.

The profiles have version 4 (ICC.1:2022), and consist of a matrix and tone curves. Two calls with the same colour space
return identical bytes.
"""

import functools
import hashlib
import struct

import numpy as np
from numpy.typing import NDArray

from l3cli.physics.spaces import Curve, Space, adaptation_matrix

D50 = np.array([0.9642, 1.0, 0.8249])  # XYZ of the profile connection space, rounded as in ICC.1
VERSION = 0x04400000
DATE = (2000, 1, 1, 0, 0, 0)  # creation date, which is required; constant, so that equal profiles have identical bytes
POWER, SRGB_LIKE = 0, 3  # function types of parametricCurveType
ID = slice(84, 100)  # header bytes of the profile ID, an MD5 digest
NOT_HASHED = (slice(44, 48), slice(64, 68), ID)  # header bytes that the digest excludes: flags, rendering intent, profile ID


@functools.cache
def icc_profile(space: Space) -> bytes:
    """Return the ICC profile of a colour space. Colours are adapted from the white of the colour space to D50."""
    adapted = adaptation_matrix(space.neutral_xyz, D50)
    colorants = (adapted @ space.to_xyz).T
    tags = {
        b"desc": _text(space.title),
        b"cprt": _text("CC0"),
        b"wtpt": _xyz(D50),
        b"chad": _tag(b"sf32", _fixed(adapted)),
        **{name: _xyz(colorant) for name, colorant in zip((b"rXYZ", b"gXYZ", b"bXYZ"), colorants, strict=True)},
        **dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), _curve(space.curve)),
    }
    places: dict[bytes, int] = {}  # tag content → offset, because tags with equal content share one copy
    table, body, start = struct.pack(">I", len(tags)), b"", 128 + 4 + 12 * len(tags)
    for name, content in tags.items():
        if content not in places:
            places[content] = start + len(body)
            body += content + bytes(-len(content) % 4)
        table += struct.pack(">4sII", name, places[content], len(content))
    profile = bytearray(_header(start + len(body)) + table + body)
    hashed = bytearray(profile)
    for field in NOT_HASHED:
        hashed[field] = bytes(field.stop - field.start)
    profile[ID] = hashlib.md5(hashed, usedforsecurity=False).digest()
    return bytes(profile)


def _header(size: int) -> bytes:
    fields = struct.pack(">I4sI4s4s4s6H4s", size, bytes(4), VERSION, b"mntr", b"RGB ", b"XYZ ", *DATE, b"acsp")
    intent = bytes(28) + _fixed(D50)  # zeros for platform, flags, device, attributes and rendering intent (perceptual)
    return (fields + intent).ljust(128, b"\0")


def _tag(kind: bytes, content: bytes) -> bytes:
    return kind + bytes(4) + content


def _fixed(numbers: NDArray[np.floating]) -> bytes:
    """Encode numbers as s15Fixed16Number: big-endian fixed point with 16 fractional bits."""
    return np.rint(np.asarray(numbers) * 65536).astype(">i4").tobytes()


def _xyz(numbers: NDArray[np.floating]) -> bytes:
    return _tag(b"XYZ ", _fixed(numbers))


def _text(text: str) -> bytes:
    content = text.encode("utf-16-be")
    return _tag(b"mluc", struct.pack(">II4sII", 1, 12, b"enUS", len(content), 28) + content)


def _curve(curve: Curve | None) -> bytes:
    """Return the tone-curve tag, which converts encoded values to linear values.

    The linear value is ((value + offset) / gain)^(1 / exponent) above the knee, and proportional to the encoded value below
    it. If `curve` is None, both values are equal.
    """
    if curve is None:
        return _tag(b"para", struct.pack(">HH", POWER, 0) + _fixed(np.ones(1)))
    parts = [1 / curve.exponent, 1 / curve.gain, curve.offset / curve.gain, 1 / curve.slope, curve.slope * curve.knee]
    return _tag(b"para", struct.pack(">HH", SRGB_LIKE, 0) + _fixed(np.array(parts)))
