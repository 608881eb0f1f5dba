"""Metadata of a rendered frame's file; none of it depends on when or where it was made."""

from dataclasses import dataclass
from fractions import Fraction

from l3cli import __version__
from l3cli.frames.frame import Shot


@dataclass(frozen=True)
class Label:
    """Settings of the shot, and the files that its picture was made from."""

    shot: Shot = Shot()
    exposure: float | None = None  # s
    table: str = ""  # SHA-256 of the transform table's file
    frame: str = ""  # SHA-256 of what: see `of_file`, `of_values`

    @property
    def software(self) -> str:
        return f"l3cli {__version__}" if self.table else ""

    @property
    def description(self) -> str:
        return f"transform table SHA-256 {self.table}, {self.frame}" if self.table else ""

    @property
    def xmp(self) -> str:
        """The same as an XMP packet, for formats that OpenImageIO writes no Exif into."""
        shot = self.shot
        numbers = {"exif:ExposureTime": self.exposure, "exif:FNumber": shot.f_number, "exif:FocalLength": shot.focal_length}
        numbers["exifEX:PhotographicSensitivity"] = round(shot.iso)
        texts = {
            "tiff:Make": shot.make,
            "tiff:Model": shot.model,
            "exifEX:LensModel": shot.lens,
            "tiff:Software": self.software,
        }
        day, _, hour = shot.date.partition(" ")
        texts["exif:DateTimeOriginal"] = f"{day.replace(':', '-')}T{hour}" if shot.date else ""
        texts["tiff:ImageDescription"] = self.description
        fractions = {name: str(Fraction(value).limit_denominator(10**6)) for name, value in numbers.items() if value}
        stated = {name: text for name, text in {**texts, **fractions}.items() if text}
        from xml.sax.saxutils import quoteattr  # it imports what browsers need

        inside = "".join(f" {name}={quoteattr(text)}" for name, text in stated.items())
        return PACKET.format(inside)


PACKET = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description rdf:about="" xmlns:tiff="http://ns.adobe.com/tiff/1.0/" xmlns:exif="http://ns.adobe.com/exif/1.0/"'
    ' xmlns:exifEX="http://cipa.jp/exif/1.0/"{}/>'
    "</rdf:RDF></x:xmpmeta>"
)
NOTHING = Label()


def of_file(digest: str) -> str:
    """Return the frame that a raw file holds alone, by the file's SHA-256."""
    return f"raw file SHA-256 {digest}"


def of_values(digest: str) -> str:
    """Return a frame of a stack or stream, by the SHA-256 of its values, row by row, 16 bits, lower byte first."""
    return f"raw values SHA-256 {digest}"
