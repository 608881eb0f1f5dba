"""Opcode lists in DNG files (Adobe DNG 1.7, chapter 7): corrections that a file requests for the mosaic or the picture.

l3 corrects bad pixels, converts gain maps and radial vignetting to a gain per pixel, and applies rectilinear lens warps to
the picture. All other opcodes are unsupported. If they are optional, l3 ignores them with a note. If they are required, l3
rejects the file, unless the user chooses to ignore them.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.frames.lens_warp import BLUE, GREEN, RED, UNCHANGED, LensWarp, corrected_places

LISTS = ("OpcodeList1", "OpcodeList2", "OpcodeList3")  # opcodes for stored, linear and demosaicked values
WARP_RECTILINEAR, FIX_VIGNETTE_RADIAL, FIX_BAD_PIXELS_CONSTANT, FIX_BAD_PIXELS_LIST, GAIN_MAP = 1, 3, 4, 5, 9
SUPPORTED = ((4, 5), (5, 3, 9), (3, 9, 1))  # supported opcodes in each of LISTS
NAMES = (
    "", "WarpRectilinear", "WarpFisheye", "FixVignetteRadial", "FixBadPixelsConstant", "FixBadPixelsList", "TrimBounds",
    "MapTable", "MapPolynomial", "GainMap", "DeltaPerRow", "DeltaPerColumn", "ScalePerRow", "ScalePerColumn",
    "WarpRectilinear2",
)  # fmt: skip
OPTIONAL = 1  # flag of opcodes that readers may ignore
MOST_OPCODES = 1000  # maximum number of opcodes in a list
MOST_GAIN = 64.0  # largest plausible gain
MOST_PLANES = 16  # maximum number of colour planes
MOST_WARP = 10.0  # largest plausible factor by which a warp lengthens or shortens distances from the centre
HEAD = struct.Struct(">IIII")  # identifier, version, flags, number of bytes
AREA = struct.Struct(">8I")  # top, left, bottom, right, first plane, number of planes, row pitch, column pitch
MAP = struct.Struct(">2I4dI")  # number of points down and across, spacings, origins, number of planes
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Opcode:
    """An entry in an opcode list."""

    stage: int  # index in LISTS
    number: int
    optional: bool
    content: bytes


@dataclass(frozen=True)
class GainMap:
    """Gains on a coarse grid, for some of the rows, columns and colour planes."""

    stage: int  # index in LISTS
    area: tuple[slice, slice]  # rows and columns to which the gains apply
    planes: range  # colour planes to which the gains apply
    spacing: tuple[float, float]  # grid spacing (down, across), as fractions of the image height and width
    origin: tuple[float, float]  # position of the first grid point (down, across), in the units of `spacing`
    gains: Floats  # (row, col, plane)


@dataclass(frozen=True)
class Vignette:
    """Radial gain 1 + k0 r² + k1 r⁴ + …, where r is the distance from the centre, relative to the farthest corner."""

    terms: tuple[float, ...]  # k0, k1, …
    centre: tuple[float, float]  # centre (down, across), as fractions of the image height and width
    warps: tuple[LensWarp, ...]  # warps that precede this opcode; the gain applies to the warped picture


@dataclass(frozen=True)
class Opcodes:
    """The corrections that a file requests."""

    constants: tuple[int, ...] = ()  # stored values that mark bad pixels
    rects: tuple[NDArray[np.int64], ...] = ()  # (rectangle, 5) areas of bad pixels: index in LISTS, top, left, bottom, right
    gains: tuple[GainMap | Vignette, ...] = ()
    warps: tuple[LensWarp, ...] = ()  # lens warps, which apply to the picture of the active area
    notes: tuple[str, ...] = ()  # notes about ignored optional opcodes
    demanded: tuple[str, ...] = ()  # required opcodes that l3 does not support

    def __bool__(self) -> bool:
        return bool(self.constants or self.rects or self.gains)


# ------------------------------------------------------------------------------------------------------------ reading


def read_opcodes(page: Any, planes: Sequence[int], area: tuple[int, int]) -> Opcodes:
    """Read the opcode lists on a page.

    Parameters
    ----------
    page : tifffile.TiffPage
        The page.
    planes : sequence of int
        Colour code of each plane in the demosaicked picture.
    area : tuple of int
        Number of rows and columns in the active area.

    Returns
    -------
    Opcodes
        The corrections. Empty if the page has no opcodes.

    Raises
    ------
    ValueError, struct.error
        If a list is damaged or contains implausible values.
    """
    found: dict[str, list[Any]] = {"constants": [], "rects": [], "gains": [], "warps": [], "notes": [], "demanded": []}
    linearised = page.tags.valueof("LinearizationTable") is not None
    for each in _listed(page):
        supported = each.number in SUPPORTED[each.stage] and not (each.number == GAIN_MAP and found["warps"])
        if not supported or (each.number == FIX_BAD_PIXELS_CONSTANT and linearised):
            name = NAMES[each.number] if 0 < each.number < len(NAMES) else f"opcode {each.number}"
            named = f"{name}{' after a lens warp' * bool(found['warps'])} in {LISTS[each.stage]}"
            if each.optional:
                found["notes"].append(f"the optional correction {named} is ignored")
            else:
                found["demanded"].append(named)
        elif each.number == WARP_RECTILINEAR:
            found["warps"].extend(_warps(each, planes, area))
        elif each.number == FIX_BAD_PIXELS_CONSTANT:
            found["constants"].append(struct.unpack(">II", each.content)[0])
        elif each.number == FIX_BAD_PIXELS_LIST:
            found["rects"].append(_bad_rects(each))
        else:
            after = tuple(found["warps"])
            found["gains"].append(_vignette(each, after) if each.number == FIX_VIGNETTE_RADIAL else _gain_map(each))
    return Opcodes(**{name: tuple(values) for name, values in found.items()})


def _listed(page: Any) -> list[Opcode]:
    opcodes = []
    for stage, tag in enumerate(LISTS):
        content = page.tags.valueof(tag)
        if content is None:
            continue
        content = bytes(content)
        (count,) = struct.unpack_from(">I", content)
        if count > MOST_OPCODES:
            raise ValueError(f"a list contains {count} opcodes")
        at = 4
        for _ in range(count):
            number, _, flags, size = HEAD.unpack_from(content, at)
            at += HEAD.size + size
            if at > len(content):
                raise ValueError("an opcode extends beyond its list")
            opcodes.append(Opcode(stage, number, bool(flags & OPTIONAL), content[at - size : at]))
    return opcodes


def _bad_rects(opcode: Opcode) -> NDArray[np.int64]:
    """Return the rectangles of bad pixels in an opcode, as in `Opcodes.rects`. A single pixel becomes a 1×1 rectangle.

    Raises ValueError if the opcode has the wrong length.
    """
    _, points, rects = struct.unpack_from(">III", opcode.content)
    if len(opcode.content) != 12 + 8 * points + 16 * rects:
        raise ValueError("a list of bad pixels has the wrong length")
    numbers = np.frombuffer(opcode.content, ">i4", offset=12).astype(np.int64)
    corners, listed = numbers[: 2 * points].reshape(-1, 2), numbers[2 * points :].reshape(-1, 4)
    return np.insert(np.concatenate([np.hstack([corners, corners + 1]), listed]), 0, opcode.stage, axis=1)


def _gain_map(opcode: Opcode) -> GainMap:
    top, left, bottom, right, plane, count, down, across = AREA.unpack_from(opcode.content)
    *numbers, map_planes = MAP.unpack_from(opcode.content, AREA.size)
    rows, cols = int(numbers[0]), int(numbers[1])
    gains = np.frombuffer(opcode.content, ">f4", offset=AREA.size + MAP.size).astype(np.float64)
    spacing = tuple(1.0 if points == 1 else value for points, value in zip((rows, cols), numbers[2:4], strict=True))
    origin = tuple(0.0 if points == 1 else value for points, value in zip((rows, cols), numbers[4:6], strict=True))
    if not (min(rows, cols, map_planes, count, down, across) >= 1 and gains.size == rows * cols * map_planes):
        raise ValueError("a gain map has the wrong number of gains")
    if not (np.isfinite((*spacing, *origin)).all() and min(spacing) > 0):
        raise ValueError(f"a gain map has an invalid spacing {spacing} or origin {origin}")
    if not 0 < gains.min() <= gains.max() <= MOST_GAIN:
        raise ValueError(f"a gain map has gains of {gains.min():.3g}…{gains.max():.3g}")
    area = slice(top, bottom, down), slice(left, right, across)
    planes = range(plane, min(plane + count, MOST_PLANES if opcode.stage == 2 else 1))  # a mosaic has one plane
    return GainMap(opcode.stage, area, planes, spacing, origin, gains.reshape(rows, cols, map_planes))  # type: ignore[arg-type]


def _vignette(opcode: Opcode, warps: tuple[LensWarp, ...]) -> Vignette:
    *terms, across, down = struct.unpack(">7d", opcode.content)
    if not np.isfinite((*terms, across, down)).all():
        raise ValueError("some vignetting terms are not finite")
    return Vignette(tuple(terms), (down, across), warps)


def _warps(opcode: Opcode, planes: Sequence[int], area: tuple[int, int]) -> list[LensWarp]:
    """Return the warp in an opcode as a list, which is empty if the warp does not move any pixel.

    Raises ValueError if the number of coefficient sets is neither 1 nor the number of planes, if a coefficient or the centre
    is out of range, or if the warp changes distances by more than a factor of MOST_WARP.
    """
    (count,) = struct.unpack_from(">I", opcode.content)
    if count not in (1, len(planes)):
        raise ValueError(f"a lens warp has terms for {count} colour planes instead of {len(planes)}")
    *numbers, across, down = struct.unpack(f">{6 * count + 2}d", opcode.content[4:])
    terms = np.reshape(numbers, (count, 6))
    factors = np.polynomial.polynomial.polyval(np.linspace(0, 1, 65), terms[:, :4].T)
    if not (0 <= down <= 1 and 0 <= across <= 1):
        raise ValueError(f"the centre of a lens warp, ({across:.3g}, {down:.3g}), is outside the picture")
    if not np.isfinite(terms).all():
        raise ValueError("a lens warp has coefficients that are not finite numbers")
    if np.abs(terms[:, 4:]).max() > 1:
        raise ValueError(f"a lens warp has a tangential coefficient of ±{np.abs(terms[:, 4:]).max():.3g}, outside -1 to 1")
    if not 1 / MOST_WARP <= factors.min() <= factors.max() <= MOST_WARP:
        raise ValueError(f"a lens warp changes distances by {factors.min():.3g}…{factors.max():.3g}")
    places = [planes.index(colour) if colour in planes else 0 for colour in (RED, GREEN, BLUE)]
    red, green, blue = (tuple(terms[min(place, count - 1)].tolist()) for place in places)
    return [] if {red, green, blue} == {UNCHANGED} else [LensWarp((red, green, blue), (down, across), area)]


# -------------------------------------------------------------------------------------------------- applying opcodes


def bad_pixels(opcodes: Opcodes, stored: NDArray[np.uint16], active: tuple[int, int, int, int]) -> NDArray[np.bool_]:
    """Return a mask of the pixels in the active area, (row, col), that the opcodes mark as bad.

    Parameters
    ----------
    opcodes : Opcodes
        The file's opcodes.
    stored : ndarray, (row, col)
        Stored values of the whole image.
    active : tuple of int
        Top, left, bottom and right edges of the active area.
    """
    top, left, bottom, right = active
    bad = np.isin(stored[top:bottom, left:right], opcodes.constants)
    origins = ((top, left), (0, 0), (0, 0))
    for rects in opcodes.rects:
        for stage, *edges in rects.tolist():
            down, across = origins[stage]
            first_row, first_col, last_row, last_col = np.maximum(np.subtract(edges, (down, across, down, across)), 0)
            bad[first_row:last_row, first_col:last_col] = True
    return bad


def gain_of_pixels(
    opcodes: Opcodes, pattern: NDArray[np.int64], planes: Sequence[int], shape: tuple[int, int]
) -> NDArray[np.float32]:
    """Return the gain of each pixel in the active area, (row, col).

    Parameters
    ----------
    opcodes : Opcodes
        The file's opcodes.
    pattern : ndarray, (row, col)
        Colour codes of the CFA.
    planes : sequence of int
        Colour code of each plane.
    shape : tuple of int
        Number of rows and columns in the active area.

    Raises
    ------
    ValueError
        If a gain is not positive or is implausibly large.
    """
    with np.errstate(all="ignore"):  # an overflow makes the check below fail
        gain = _product(opcodes, pattern, planes, shape)
    if not (gain.min() > 0 and gain.max() <= MOST_GAIN):
        raise ValueError(f"the gains are {gain.min():.3g}…{gain.max():.3g}")
    return gain.astype(np.float32)


def _product(opcodes: Opcodes, pattern: NDArray[np.int64], planes: Sequence[int], shape: tuple[int, int]) -> Floats:
    gain = np.ones(shape)
    for each in opcodes.gains:
        if isinstance(each, Vignette):
            gain *= _radial(each, shape)
            continue
        for index, plane in enumerate(each.planes):
            if each.stage == 2 and plane >= len(planes):
                continue
            within = gain[each.area]
            factor = _interpolated(each, min(index, each.gains.shape[2] - 1), shape)
            if each.stage == 2:
                sites = [np.arange(shape[axis])[each.area[axis]] % pattern.shape[axis] for axis in (0, 1)]
                factor[pattern[np.ix_(*sites)] != planes[plane]] = 1.0
            within *= factor
    return gain


def _radial(vignette: Vignette, shape: tuple[int, int]) -> Floats:
    rows, cols = np.arange(shape[0], dtype=float)[:, None], np.arange(shape[1], dtype=float)
    if vignette.warps:
        rows, cols = corrected_places(vignette.warps, rows, cols)
    down, across = (
        (places + 0.5) - middle * length for places, length, middle in zip((rows, cols), shape, vignette.centre, strict=True)
    )
    corners = [max(middle, 1 - middle) * length for length, middle in zip(shape, vignette.centre, strict=True)]
    squared = (down**2 + across**2) / (corners[0] ** 2 + corners[1] ** 2)
    return np.asarray(np.polynomial.polynomial.polyval(squared, (1.0, *vignette.terms)))


def _interpolated(each: GainMap, plane: int, shape: tuple[int, int]) -> Floats:
    """Interpolate a gain map linearly in its area, (row, col). Beyond the grid, the gains are constant."""
    sides = []
    for axis in (0, 1):
        place = (np.arange(shape[axis])[each.area[axis]] + 0.5) / shape[axis]
        points = each.gains.shape[axis]
        index = np.clip((place - each.origin[axis]) / each.spacing[axis], 0, points - 1)
        below = np.minimum(index.astype(int), max(points - 2, 0))
        sides.append((below, np.minimum(below + 1, points - 1), index - below))
    (top, bottom, down), (left, right, across) = sides
    grid = each.gains[..., plane]
    upper = grid[top][:, left] * (1 - across) + grid[top][:, right] * across
    lower = grid[bottom][:, left] * (1 - across) + grid[bottom][:, right] * across
    return np.asarray(upper * (1 - down[:, None]) + lower * down[:, None])
