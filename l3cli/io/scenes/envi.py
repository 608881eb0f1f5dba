"""Read ENVI cubes, which consist of a text header and a data file in the same folder.

FIELDS lists every standard header field and how l3 uses it. The list follows "ENVI Header Files" by NV5 Geospatial, and
includes the frame offsets of ENVI Classic. l3 ignores other fields, which camera manufacturers add. `unknown` lists the
ignored fields that could affect the values.
"""

import math
import mmap
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.frames.marks import missing, scaled
from l3cli.frames.scene import SpectralCube
from l3cli.io.scenes.wavelengths import UNSTATED, in_nm, of_names
from l3cli.system.files import open_regular
from l3cli.system.limits import read_bounded, require_picture

TYPES = {1: "u1", 2: "i2", 3: "i4", 4: "f4", 5: "f8", 12: "u2", 13: "u4", 14: "i8", 15: "u8"}  # "data type" → numpy type
COMPLEX = (6, 9)  # "data type" of complex numbers
AXES = {"bsq": ("bands", "lines", "samples"), "bil": ("lines", "bands", "samples"), "bip": ("lines", "samples", "bands")}
STANDARD = ("envi standard", "envi", "standard", *UNSTATED)  # file types of uncompressed cubes
DATA = ("", ".img", ".dat", ".raw", ".bsq", ".bil", ".bip", ".bin", ".cube", ".hyspex")  # suffixes of data files
CURE = "use a complete ENVI header"

# Words in a manufacturer's field name that suggest that the field affects the values, as in "radiance gain".
CHANGING = re.compile(
    r"gain|offset|scal|factor|calib|coeff|multipl|slope|intercept|bias|dark|black|white|ceiling|gamma|linear|"
    r"no ?data|ignore|mask|bad|invalid|fill|unit|quantity|radiance|reflectance|responsivity|sensitivity"
)

READ, REFUSED, HARMLESS = "read", "refused", "harmless"


@dataclass(frozen=True)
class HeaderField:
    """A field in an ENVI header."""

    name: str
    fate: str  # READ: used. REFUSED: rejected if its value is unsupported. HARMLESS: ignored, because it has no effect.
    meaning: str  # meaning of the field, for the documentation


FIELDS = (
    HeaderField("samples", READ, "number of columns"),
    HeaderField("lines", READ, "number of rows"),
    HeaderField("bands", READ, "number of bands"),
    HeaderField(
        "data type", READ, "type of the values: 1, 2, 3, 4, 5, 12, 13, 14 or 15; complex numbers (6, 9) are rejected"
    ),
    HeaderField("interleave", READ, "order of the values: bsq, bil or bip; optional if there is only one band"),
    HeaderField("byte order", READ, "byte order of the values: 0 (default) is little-endian, 1 is big-endian"),
    HeaderField("header offset", READ, "bytes to skip at the start of the data file"),
    HeaderField("major frame offsets", READ, "bytes to skip before and after each band (bsq) or each line (bil, bip)"),
    HeaderField(
        "minor frame offsets", READ, "bytes to skip before and after each line of a band (bsq, bil) or each pixel (bip)"
    ),
    HeaderField("wavelength", READ, "wavelength of each band"),
    HeaderField(
        "wavelength units",
        READ,
        "unit of the wavelengths, such as Nanometers, Micrometers, Wavenumber or GHz; Index means no wavelengths",
    ),
    HeaderField("band names", READ, 'wavelengths in names such as "450 nm", which l3 uses if `wavelength` is missing'),
    HeaderField("bbl", READ, "1 for a good band, 0 for a bad band; l3 interpolates bad bands from the good bands"),
    HeaderField(
        "data ignore value",
        READ,
        "value that marks missing data; pixels with this value in any good band are not used in training",
    ),
    HeaderField("reflectance scale factor", READ, "stored value of a perfect white"),
    HeaderField("data gain values", READ, "factors by which l3 multiplies the stored values"),
    HeaderField("data offset values", READ, "offsets that l3 adds after multiplying by the data gain values"),
    HeaderField(
        "data reflectance gain values",
        READ,
        "factors that convert stored values to reflectances; for reflectance cubes, they replace the data gain values",
    ),
    HeaderField(
        "data reflectance offset values", READ, "offsets that l3 adds after multiplying by the data reflectance gain values"
    ),
    HeaderField(
        "file type",
        REFUSED,
        "rejected unless it is ENVI Standard; other types are, for example, ENVI Classification and TIFF",
    ),
    HeaderField("file compression", REFUSED, "rejected unless it is 0, because l3 reads only uncompressed data"),
    HeaderField("read procedures", REFUSED, "rejected, because only the program that the header names can read the data"),
    HeaderField("fwhm", HARMLESS, "widths of the bands; l3 treats the values as samples at the band centres"),
    HeaderField("complex function", HARMLESS, "how to display complex data, which l3 rejects"),
    HeaderField(
        "solar irradiance", HARMLESS, "solar spectrum, with which other programs compute reflectances; in l3, set `light`"
    ),
    *(
        HeaderField(name, HARMLESS, meaning)
        for name, meaning in (
            ("description", "text"),
            ("sensor type", "text"),
            ("product type", "text"),
            ("security tag", "text"),
            ("acquisition time", "time of the recording"),
            ("timestamp", "time of the recording"),
            ("sun azimuth", "position of the sun"),
            ("sun elevation", "position of the sun"),
            ("cloud cover", "percentage of cloud cover"),
            ("map info", "geographic position"),
            ("projection info", "geographic position"),
            ("coordinate system string", "geographic position"),
            ("geo points", "geographic position"),
            ("rpc info", "geographic position"),
            ("pixel size", "geographic position"),
            ("x start", "position of the cube in the original image"),
            ("y start", "position of the cube in the original image"),
            ("dem file", "terrain elevation"),
            ("dem band", "terrain elevation"),
            ("classes", "description of a classification"),
            ("class names", "description of a classification"),
            ("class lookup", "description of a classification"),
            ("spectra names", "names of spectra in a spectral library"),
            ("default bands", "how ENVI displays the image"),
            ("default stretch", "how ENVI displays the image"),
            ("color table", "how ENVI displays the image"),
            ("z plot average", "how ENVI plots spectra"),
            ("z plot range", "how ENVI plots spectra"),
            ("z plot titles", "how ENVI plots spectra"),
        )
    ),
)


@dataclass(frozen=True)
class Layout:
    """Data type and positions of the values in the data file."""

    shape: tuple[int, int, int]  # lengths of `axes`
    axes: tuple[str, str, str]  # "lines", "samples" and "bands" in file order; the last axis varies fastest
    dtype: np.dtype
    offset: int  # number of bytes before the first value
    strides: tuple[int, int, int]  # distance in bytes between neighbouring values along each of `axes`
    end: int  # minimum size of the data file in bytes

    @property
    def size(self) -> tuple[int, int]:
        return self.shape[self.axes.index("lines")], self.shape[self.axes.index("samples")]


class Header:
    """The fields in an ENVI header file, by names in lower case. Raises InputFileError if the file is not a header."""

    def __init__(self, path: Path) -> None:
        self.path, self.fields = path, _fields(path)

    def wrong(self, name: str, why: str, cure: str = CURE) -> InputFileError:
        return InputFileError(f'{self.path}: the field "{name}" {why}; {cure}')

    def text(self, name: str) -> str:
        return self.fields.get(name, "")

    def whole(self, name: str, least: int = 0, default: int | None = None) -> int:
        """Return a field as an integer, or `default` if the field is missing.

        Raises InputFileError if the field is not an integer of at least `least`, or if it is missing without a default.
        """
        text = self.text(name)
        if not text and default is not None:
            return default
        if not text:
            raise self.wrong(name, "is missing")
        if not text.isdecimal() or int(text) < least:
            raise self.wrong(name, f'is "{text[:40]}" but must be an integer of at least {least}')
        return int(text)

    def numbers(self, name: str, count: int) -> NDArray[np.float64] | None:
        """Return the numbers in a field, (count,), or None if the field is missing. A single number is repeated.

        Raises InputFileError if the number of entries is wrong, or if an entry is not a number.
        """
        if not self.text(name):
            return None
        words = [word for word in re.split(r"[,\s]+", self.text(name)) if word]
        try:
            listed = np.array([float(word) for word in words])
        except ValueError as error:
            raise self.wrong(name, f"contains an entry that is not a number ({error})") from error
        if listed.size not in (1, count):
            raise self.wrong(name, f"contains {listed.size} numbers instead of {count}")
        return np.broadcast_to(listed, count)


def read(path: Path, holds: str = "reflectance") -> SpectralCube:
    """Read a cube from its ENVI header (.hdr) and the data file in the same folder.

    Parameters
    ----------
    path : Path
        The header.
    holds : str
        Content of the cube according to the recipe: "reflectance", "radiance" or "photons". For "reflectance", the header's
        reflectance gains are applied if it contains any. In all other cases, its radiance gains are applied.

    Returns
    -------
    SpectralCube
        The cube, (row, col, band). Its wavelengths are None if the header contains none.

    Raises
    ------
    InputFileError
        If the data file is missing or too short, or if the header is invalid or requires a feature that l3 does not support.
    """
    header = Header(path)
    layout = _layout(header)
    wavelength, good = _wavelengths(header), _good_bands(header)
    gain, offset, white = _scale(header, holds)
    data = _whole_data(path, layout)
    with open(data, "rb") as stream:
        content = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    stored = np.ndarray(layout.shape, layout.dtype, content, layout.offset, layout.strides)
    values = stored.transpose([layout.axes.index(axis) for axis in ("lines", "samples", "bands")])
    mark = header.text("data ignore value")
    try:
        ignored = missing(values, float(mark), good) if mark else None
    except ValueError as error:
        raise header.wrong("data ignore value", f'is "{mark[:40]}" but must be a number', "correct the field") from error
    return SpectralCube(scaled(values, gain, offset), wavelength, white, good, ignored)


def size(path: Path, holds: str = "reflectance") -> tuple[int, int]:
    """Read the number of rows and columns from the header. Raises the same errors as `read`."""
    header = Header(path)
    layout = _layout(header)
    _wavelengths(header), _good_bands(header), _scale(header, holds), _whole_data(path, layout)
    return layout.size


def files(path: Path) -> list[Path]:
    """Return an ENVI header and its data file. Raises InputFileError if one of them is missing."""
    _fields(path)
    return [path, _data(path)]


def unknown(path: Path) -> list[str]:
    """Return the names of non-empty header fields that are not in FIELDS but probably affect the values."""
    known = {field.name for field in FIELDS}
    return [name for name, text in _fields(path).items() if name not in known and text and CHANGING.search(name)]


def _fields(path: Path) -> dict[str, str]:
    """Read the fields in a header by their names in lower case, without braces and comments.

    Raises InputFileError if the file is not an ENVI header.
    """
    # Check the first bytes, because for a large data file, the error from `read_bounded` would be misleading.
    with open_regular(path, "use the .hdr file") as stream:
        if b"ENVI" not in stream.read(64):
            raise InputFileError(f"{path} is not an ENVI header; give the .hdr file of the cube")
    content = read_bounded(path)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    if not text.lstrip().startswith("ENVI"):
        raise InputFileError(f"{path} is not an ENVI header; give the .hdr file of the cube")
    lines = [line for line in text.splitlines() if not line.lstrip().startswith(";")]  # a semicolon starts a comment
    fields, at = {}, 0
    while at < len(lines):
        name, equals, value = lines[at].partition("=")
        at += 1
        if not equals:
            continue
        value = value.strip()
        while at < len(lines) and _goes_on(value, lines[at]):
            value = f"{value} {lines[at].strip()}".strip()
            at += 1
        fields[" ".join(name.lower().split())] = value.partition("}")[0].replace("{", "").strip()
    return fields


def _goes_on(value: str, following: str) -> bool:
    """Return whether a field's value continues in the following line.

    It continues if its brace is not closed, or if it is empty and the following line starts with a brace.
    """
    return "}" not in value if value.startswith("{") else not value and following.lstrip().startswith("{")


def _data(path: Path) -> Path:
    stem = path.with_suffix("")
    for suffix in DATA:
        for data in (stem.with_name(stem.name + suffix), stem.with_name(stem.name + suffix.upper())):
            if data.is_file() and data != path:
                return data
    raise InputFileError(f"{path}: the data file is missing; put {stem.name} or {stem.name}.img beside the header")


def _whole_data(path: Path, layout: Layout) -> Path:
    """Return the data file that belongs to a header. Raises InputFileError if it is missing or too short."""
    data = _data(path)
    size = data.stat().st_size
    if size < layout.end:
        raise InputFileError(f"{data} has {size} bytes, but its header requires {layout.end}; use the whole file")
    return data


def _layout(header: Header) -> Layout:
    """Return the layout that a header describes. Raises InputFileError if a field is missing, invalid or unsupported."""
    sizes = {name: header.whole(name, 1) for name in ("lines", "samples", "bands")}
    kind = " ".join(header.text("file type").split())
    if kind.lower() not in STANDARD:
        raise header.wrong("file type", f'is "{kind[:40]}", which l3 does not support', "save the cube as ENVI Standard")
    if header.text("read procedures"):
        raise header.wrong(
            "read procedures", "means that only another program can read the data", "save the cube as ENVI Standard"
        )
    if header.text("file compression").lower() not in ("", "0", "none", "false"):
        raise header.wrong("file compression", "means that the data are compressed", "save the cube without compression")
    code = header.whole("data type")
    if code not in TYPES:
        what = " (complex numbers)" if code in COMPLEX else ""
        raise header.wrong("data type", f"is {code}{what}, which l3 does not support", "save the cube as real numbers")
    order = header.whole("byte order", default=0)
    if order > 1:
        raise header.wrong("byte order", f"is {order} but must be 0 or 1")
    interleave = (header.text("interleave") or ("bsq" if sizes["bands"] == 1 else "")).lower()
    if interleave not in AXES:
        why = f'is "{interleave[:40]}" but must be bsq, bil or bip' if interleave else "is missing"
        raise header.wrong("interleave", why)
    axes, dtype = AXES[interleave], np.dtype("<>"[order] + TYPES[code])
    require_picture(str(header.path), sizes["lines"], sizes["samples"], sizes["bands"])
    shape = sizes[axes[0]], sizes[axes[1]], sizes[axes[2]]
    (before, after), (above, below) = (_frame_offsets(header, f"{which} frame offsets") for which in ("minor", "major"))
    minor = before + shape[2] * dtype.itemsize + after
    major = above + shape[1] * minor + below
    start = header.whole("header offset", default=0)
    return Layout(shape, axes, dtype, start + above + before, (major, minor, dtype.itemsize), start + shape[0] * major)


def _frame_offsets(header: Header, name: str) -> tuple[int, int]:
    listed = header.numbers(name, 2)
    if listed is None:
        return 0, 0
    if not all(number >= 0 and number == int(number) for number in listed):
        raise header.wrong(name, "must contain two integers of at least 0 (numbers of bytes)")
    return int(listed[0]), int(listed[1])


def _wavelengths(header: Header) -> NDArray[np.float64] | None:
    """Return each band's wavelength in nm, from the field "wavelength" or, if it is missing, from the band names.

    Returns None if the header contains no wavelengths. Raises InputFileError if the field or its unit is invalid.
    """
    bands = header.whole("bands", 1)
    if (listed := header.numbers("wavelength", bands)) is not None:
        try:
            wavelength = in_nm(listed, header.text("wavelength units"))
        except ValueError as error:
            name = "wavelength units" if "unit" in str(error) else "wavelength"
            raise InputFileError(f'{header.path}: the field "{name}" is invalid: {error}') from error
        if wavelength is not None:
            return wavelength
    names = [name.strip() for name in header.text("band names").split(",") if name.strip()]
    stated = [each for each in of_names(names) if each is not None]
    return np.array(stated) if len(stated) == len(names) == bands else None


def _good_bands(header: Header) -> NDArray[np.bool_] | None:
    listed = header.numbers("bbl", header.whole("bands", 1))
    if listed is None:
        return None
    if not np.isin(listed, (0.0, 1.0)).all():
        raise header.wrong("bbl", "contains entries other than 0 and 1", "mark bad bands with 0 and good bands with 1")
    if not listed.any():
        raise header.wrong("bbl", "marks all bands as bad", "mark good bands with 1")
    return np.asarray(listed == 1.0)


def _scale(header: Header, holds: str) -> tuple[NDArray[np.float64], NDArray[np.float64], float | None]:
    """Return three values: the gain of each band, the offset of each band, and the scaled value of a perfect white.

    The third value is None if the header does not specify it. The gains and offsets are those for reflectance if `holds` is
    "reflectance" and the header contains them. Otherwise, they are those for radiance. Raises InputFileError if a field is
    invalid, or if the header contains two fields that both scale the data.
    """
    bands = header.whole("bands", 1)
    white = None
    if text := header.text("reflectance scale factor"):
        try:
            white = float(text)
        except ValueError:
            white = math.nan
        if not 0 < white < math.inf:
            raise header.wrong(
                "reflectance scale factor", f'is "{text[:40]}" but must be a number above zero', "correct the field"
            )
    to_radiance, to_reflectance = (_linear(header, kind, bands) for kind in ("data", "data reflectance"))
    if to_reflectance is not None and holds == "reflectance":
        if white is not None:
            raise header.wrong(
                "reflectance scale factor",
                'and the field "data reflectance gain values" both scale the data',
                "remove one of the two fields",
            )
        return *to_reflectance, 1.0
    if to_radiance is not None:
        if white is not None and holds == "reflectance":
            raise header.wrong(
                "reflectance scale factor",
                'and the field "data gain values" both scale the data',
                'remove one of the two fields, or set holds = "radiance" in the recipe',
            )
        return *to_radiance, None
    if to_reflectance is not None:
        raise header.wrong(
            "data reflectance gain values",
            f"converts the data to reflectance, not to {holds}",
            'remove the key "holds" from the recipe',
        )
    return np.ones(bands), np.zeros(bands), white


def _linear(header: Header, kind: str, bands: int) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Return each band's gain and offset from the fields with names that begin with `kind`.

    Missing gains are 1, and missing offsets are 0. Returns None if all gains are 1 and all offsets are 0.
    """
    gain, offset = (header.numbers(f"{kind} {what} values", bands) for what in ("gain", "offset"))
    gain, offset = np.ones(bands) if gain is None else gain, np.zeros(bands) if offset is None else offset
    if not (np.isfinite(gain).all() and np.isfinite(offset).all() and gain.all()):
        raise header.wrong(
            f"{kind} gain values",
            f'contains a gain of zero or a value that is not finite, or the field "{kind} offset values" does',
            "correct the values",
        )
    return None if (gain == 1).all() and (offset == 0).all() else (gain, offset)
