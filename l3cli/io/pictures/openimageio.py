"""Write pictures (PNG, TIFF, JPEG, JPEG XL) and linear values (EXR, TIFF) with OpenImageIO."""

import contextlib
import errno
import os
import struct
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from l3cli.errors import L3Error
from l3cli.io.images import EXPOSURE_TIME
from l3cli.io.pictures.icc import icc_profile
from l3cli.io.pictures.registry import NOTHING, Label, Picture
from l3cli.io.tags import SHOT, shot_entries
from l3cli.physics.spaces import SRGB
from l3cli.physics.spectra import RADIANCES, REFLECTANCES
from l3cli.system.files import atomic_output, write_whole
from l3cli.system.signals import held_back_in

EXR, PNG, JPEG_XL = ".exr", ".png", ".jxl"
# Suffix → compression settings. Noise is almost incompressible: the strongest compression would take seven times as long,
# but reduce file sizes by only a tenth.
COMPRESSION: dict[str, dict[str, str | int]] = {
    # The PNG filter predicts each value from the mean of two neighbours. After that, longer sequences rarely repeat, so
    # run-length encoding is sufficient and saves the slow search for repetitions.
    PNG: {"compression": "rle", "png:compressionLevel": 1, "png:filter": 64},
    ".jpg": {"Compression": "jpeg:95", "jpeg:subsampling": "4:4:4"},
    ".jpeg": {"Compression": "jpeg:95", "jpeg:subsampling": "4:4:4"},
    JPEG_XL: {"compression": "lossless", "jpegxl:effort": 1},
}
EXIF_SRGB, EXIF_OTHER = 1, 65535  # values of the Exif tag ColorSpace
XMP = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description rdf:about="" xmlns:tiff="http://ns.adobe.com/tiff/1.0/" xmlns:exif="http://ns.adobe.com/exif/1.0/"'
    ' xmlns:exifEX="http://cipa.jp/exif/1.0/"{}/>'
    "</rdf:RDF></x:xmpmeta>"
)


def encode(path: Path, picture: Picture) -> bytes:
    """Encode a picture, including its metadata and colour space, in the format implied by the suffix of `path`.

    The colour space is stored as an ICC profile or, in EXR files, as the chromaticities of the primaries and of white. EXR
    files with spectra also have the attribute "spectralLayoutVersion".
    """
    pixels, space, suffix = picture.pixels, picture.space, path.suffix.lower()
    spec = _spec(pixels)
    if pixels.dtype.kind == "f":
        spec.channelnames, spec.alpha_channel = picture.names, -1
    if suffix == EXR and picture.names in (REFLECTANCES, RADIANCES):
        spec.attribute("spectralLayoutVersion", "1.0")
    if space is not None and suffix == EXR:
        chromaticities = [value for point in (*space.primaries, space.white) for value in point]
        spec.attribute("chromaticities", oiio.TypeDesc("float[8]"), chromaticities)
        if space.neutral:
            spec.attribute("adoptedNeutral", oiio.TypeDesc("float[2]"), space.neutral)
    elif space is not None:
        is_named = space == SRGB and suffix != PNG  # PNG files cannot contain both a profile and the name of a colour space
        spec.attribute("oiio:ColorSpace", "sRGB" if is_named else "data")  # without this, OpenImageIO would assume sRGB
        spec.attribute("Exif:ColorSpace", EXIF_SRGB if space == SRGB else EXIF_OTHER)
        profile = np.frombuffer(icc_profile(space), np.uint8)
        spec.attribute("ICCProfile", oiio.TypeDesc(f"uint8[{profile.size}]"), profile)
    _add_label(spec, picture.label)
    for name, value in COMPRESSION.get(suffix, {"compression": "none"}).items():
        spec.attribute(name, value)
    content = encoded(path.name, spec, pixels)
    if suffix != JPEG_XL or picture.label == NOTHING:
        return content
    packet = _xmp(picture.label).encode()  # OpenImageIO cannot write Exif metadata to JPEG XL files
    return content + struct.pack(">I4s", 8 + len(packet), b"xml ") + packet


def _spec(pixels: NDArray[Any]) -> Any:
    rows, cols, values = pixels.shape
    return oiio.ImageSpec(cols, rows, values, "float" if pixels.dtype.kind == "f" else str(pixels.dtype))


def _add_label(spec: Any, label: Label) -> None:
    stated: dict[str, Any] = {EXPOSURE_TIME: label.exposure}
    stated |= {other: getattr(label.shot, name) for name, (_, other) in SHOT.items() if name != "iso"}
    stated |= {"Software": label.software, "ImageDescription": label.description}
    for name, value in stated.items():
        if value:
            spec.attribute(name, value)
    if iso := round(label.shot.iso):
        spec.attribute("Exif:PhotographicSensitivity", min(iso, 65535))  # this tag has only 16 bits
        spec.attribute("Exif:ISOSpeed", iso)  # OpenImageIO does not write PhotographicSensitivity to TIFF files


def _xmp(label: Label) -> str:
    """Format a picture's metadata as an XMP packet."""
    from xml.sax.saxutils import quoteattr

    shot = label.shot
    day, _, hour = shot.date.partition(" ")
    texts = {
        "tiff:Make": shot.make,
        "tiff:Model": shot.model,
        "exifEX:LensModel": shot.lens,
        "tiff:Software": label.software,
        "exif:DateTimeOriginal": f"{day.replace(':', '-')}T{hour}" if shot.date else "",
        "tiff:ImageDescription": label.description,
    }
    numbers = {"exif:ExposureTime": label.exposure, "exif:FNumber": shot.f_number, "exif:FocalLength": shot.focal_length}
    numbers["exifEX:PhotographicSensitivity"] = round(shot.iso)
    texts |= {name: str(Fraction(value).limit_denominator(10**6)) for name, value in numbers.items() if value}
    return XMP.format("".join(f" {name}={quoteattr(text)}" for name, text in texts.items() if text))


def write_mosaic(path: Path, values: NDArray[np.uint16], exposure: float | None = None) -> None:
    """Write a raw mosaic, (row, col), in DN as an uncompressed 16-bit TIFF file, replacing an existing file.

    `exposure` is the exposure time in s, or None if unknown.
    """
    spec = _spec(values[..., None])
    spec.attribute("compression", "none")
    if exposure:
        spec.attribute(EXPOSURE_TIME, exposure)
    write_whole(path, encoded(path.name, spec, values[..., None]))


def jpeg(picture: NDArray[np.uint8], quality: int) -> bytes:
    """Encode an 8-bit sRGB picture, (row, col, 3), as JPEG without chroma subsampling. `quality` is from 1 to 100."""
    spec = _spec(picture)
    spec.attribute("oiio:ColorSpace", "sRGB")
    spec.attribute("Compression", f"jpeg:{quality}")
    spec.attribute("jpeg:subsampling", "4:4:4")
    return encoded("picture.jpg", spec, picture)


@held_back_in  # the libraries would print messages if a signal interrupted them
def encoded(name: str, spec: Any, pixels: NDArray) -> bytes:
    """Encode pixels, (row, col, value), in memory, in the format that the suffix of `name` selects.

    The libraries do not write to disk directly, because on a full disk, the JPEG library would abort the program and the PNG
    library would not report an error. Raises L3Error if the pixels cannot be encoded.
    """
    spec.attribute("DateTime", "")  # no timestamp, so that the same picture always has the same bytes
    with open(os.memfd_create("picture"), "rb", buffering=0) as memory:
        sink = oiio.ImageOutput.create(f"picture{Path(name).suffix}")  # `name` might not be valid UTF-8
        if sink is None:
            raise L3Error(f"{name} cannot be encoded: {oiio.geterror().strip()}; choose another file format")
        written = sink.open(f"/proc/self/fd/{memory.fileno()}", spec) and sink.write_image(np.ascontiguousarray(pixels))
        if not (sink.close() and written):
            raise L3Error(f"{name} cannot be encoded: {sink.geterror().strip()}; choose another file format")
        return memory.read()


PAGED = (".tif", ".tiff")
MAX_PIXEL_BYTES = 4_000_000_000  # larger TIFF files are written as BigTIFF, with 64-bit offsets


class Pages:
    """A TIFF file that is written page by page.

    Parameters
    ----------
    path : Path
        The file.
    count : int or None
        Number of pages, or None if unknown.
    """

    def __init__(self, path: Path, count: int | None) -> None:
        self._path, self._count = path, count
        self._file: Any = None

    def write(self, picture: Picture) -> None:
        """Append a page. Raises OSError with an error number if the page cannot be written."""
        import tifffile

        pixels, label = picture.pixels, picture.label
        if self._file is None:
            is_big = self._count is None or self._count * pixels.nbytes > MAX_PIXEL_BYTES
            self._file = tifffile.TiffWriter(self._path, bigtiff=is_big, byteorder="<")
        rows, _, values = pixels.shape
        try:
            self._file.write(
                pixels if values > 1 else pixels[..., 0],
                photometric="rgb" if values == 3 else "minisblack",
                planarconfig="contig" if values > 1 else None,
                rowsperstrip=rows,
                metadata=None,
                software=label.software,
                description=label.description,
                iccprofile=icc_profile(picture.space) if picture.space else None,
                extratags=shot_entries(label.shot, label.exposure),
                contiguous=False,
            )
        except OSError as error:
            # An OSError without an error number comes from numpy, probably because the disk is full.
            raise OSError(error.errno or errno.ENOSPC, os.strerror(error.errno or errno.ENOSPC)) from error

    def close(self) -> None:
        if self._file is not None:
            self._file.close()


@contextlib.contextmanager
def new_pages(path: Path, count: int | None, finished: Callable[[Path], None] = lambda temporary: None) -> Iterator[Pages]:
    """Context manager that creates a multi-page TIFF file, and yields an object that appends pages to it.

    The picture is written to a temporary file. If the block succeeds, the file is renamed to `path`.

    Parameters
    ----------
    path : Path
        The file.
    count : int or None
        Number of pages, or None if unknown.
    finished : callable
        Function that is called with the temporary path when the file is complete, before it is renamed.
    """
    with atomic_output(path) as temporary:
        with contextlib.closing(Pages(temporary, count)) as pages:
            yield pages
        finished(temporary)
