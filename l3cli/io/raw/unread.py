"""File formats that l3 recognises but cannot read raw frames from, with advice for the user.

The formats are recognised by the first bytes or the suffix of a file, so that intact files are not reported as damaged.
"""

from dataclasses import dataclass
from pathlib import Path

from l3cli.errors import InputFileError
from l3cli.system.files import open_regular

DEVELOPED = "use the camera's raw file, because this file does not contain the raw values"
EXPORT = "export the frames as 16-bit TIFF files with one channel, or as .npy files"
SPECTRUM = "use this file of spectra as an illuminant or a reflectance in a recipe"


@dataclass(frozen=True)
class UnreadFormat:
    """A format that l3 recognises but does not read."""

    name: str  # noun with an article, for messages of the form "FILE is NAME; INSTEAD"
    suffixes: tuple[str, ...]  # file suffixes in lower case
    instead: str  # advice for messages, in the imperative
    magic: tuple[tuple[int, bytes], ...] = ()  # (offset, bytes) pairs, any of which identifies the format


UNREAD = (
    UnreadFormat("an XISF file of PixInsight", (".xisf",), "save the image as FITS", ((0, b"XISF0100"),)),
    UnreadFormat(
        "a Magic Lantern video", (".mlv",), "convert the video to CinemaDNG with mlv_dump or MLV App", ((0, b"MLVI"),)
    ),
    UnreadFormat("a Phantom cine video", (".cine",), EXPORT),
    UnreadFormat("a NorPix sequence", (".seq",), EXPORT, ((0, b"\xed\xfe\x00\x00N\x00o\x00r\x00p\x00i\x00x"),)),
    UnreadFormat(
        "a RED video",
        (".r3d",),
        "export raw frames in another format, if your software can, because only RED's own software decodes these videos",
    ),
    UnreadFormat("a Blackmagic RAW video", (".braw",), "record CinemaDNG, or export DNG frames"),
    UnreadFormat("a video of a Canon camera", (".crm",), "export DNG frames"),
    UnreadFormat(
        "a raw file of a Foveon sensor",
        (".x3f",),
        "use another raw converter, because these sensors have no colour filter array",
        ((0, b"FOVb"),),
    ),
    UnreadFormat("an MXF or transport stream video", (".mxf", ".mts", ".m2ts"), "record FFV1 in MKV, or DNG frames"),
    UnreadFormat("an Andor SIF file", (".sif",), EXPORT, ((0, b"Andor Technology Multi-Channel File"),)),
    UnreadFormat("a Princeton Instruments SPE file", (".spe",), EXPORT),
    UnreadFormat("a PCO file", (".b16", ".pcoraw"), EXPORT, ((0, b"PCO-"),)),
    UnreadFormat("a DICOM file", (".dcm",), EXPORT, ((128, b"DICM"),)),
    UnreadFormat("a microscope file", (".nd2", ".czi", ".lif", ".lsm", ".oib", ".oif", ".vsi"), EXPORT),
    UnreadFormat("a numpy archive", (".npz",), "save one array with numpy.save", ((0, b"PK\x03\x04"),)),
    UnreadFormat("a zarr or zip file", (".zip", ".zarr"), "unpack the file, or save one array with numpy.save"),
    UnreadFormat("a compressed file", (".gz", ".xz", ".bz2", ".zst", ".7z", ".rar"), "unpack the file"),
    UnreadFormat("an ENVI cube", (".hdr", ".bil", ".bip", ".bsq"), 'use the cube as a scene for "l3 simulate"'),
    UnreadFormat("a JCAMP-DX file", (".jdx", ".dx", ".jcm", ".jcamp"), SPECTRUM, ((0, b"##TITLE="),)),
    UnreadFormat("a text file", (".csv", ".txt", ".tsv", ".xml", ".json", ".asc"), "use a raw file"),
    UnreadFormat("a JPEG file", (".jpg", ".jpeg", ".jpe"), DEVELOPED, ((0, b"\xff\xd8\xff"),)),
    UnreadFormat("a JPEG 2000 file", (".jp2", ".j2k", ".jpx"), "convert the file to TIFF with one channel", ((4, b"jP  "),)),
    UnreadFormat("a JPEG XL file", (".jxl",), DEVELOPED),
    UnreadFormat("a HEIF file", (".heic", ".heif", ".avif"), DEVELOPED),
    UnreadFormat("a WebP, GIF or BMP file", (".webp", ".gif", ".bmp"), DEVELOPED, ((0, b"GIF8"), (8, b"WEBP"))),
    UnreadFormat("an OpenEXR or Radiance file", (".exr",), DEVELOPED, ((0, b"v/1\x01"), (0, b"#?RADIANCE"))),
    UnreadFormat("a Photoshop file", (".psd", ".psb"), DEVELOPED, ((0, b"8BPS"),)),
)
# First bytes → suffix of a format that l3 reads, to detect files with a wrong suffix.
MISNAMED = {
    b"SIMPLE  =": ".fits", b"\x89HDF\r\n\x1a\n": ".h5", b"\x93NUMPY": ".npy", b"\x89PNG": ".png", b"P5": ".pgm",
    b"LUCAM-RECORDER": ".ser", b"MATLAB 5.0 MAT-file": ".mat", b"MATLAB 7.3 MAT-file": ".mat", b"YUV4MPEG2": ".y4m",
    b"\x1aE\xdf\xa3": ".mkv",
}  # fmt: skip
START = 160  # how many bytes at the beginning of a file are examined


def refuse_unread(path: Path) -> None:
    """Raise InputFileError, with advice, if a file's format is known but unsupported, or if its suffix is wrong."""
    with open_regular(path) as stream:
        start = stream.read(START)
    suffix = path.suffix.lower()
    for magic, named in MISNAMED.items():
        if start.startswith(magic):
            raise InputFileError(f"{path} contains {named.lstrip('.').upper()} data; rename the file to {path.stem}{named}")
    by_content = (each for each in UNREAD if any(start[at:].startswith(magic) for at, magic in each.magic))
    by_suffix = (each for each in UNREAD if suffix in each.suffixes)
    known = next(by_suffix, None) or next(by_content, None)
    if known is not None:
        raise InputFileError(f"{path} is {known.name}; {known.instead}")
