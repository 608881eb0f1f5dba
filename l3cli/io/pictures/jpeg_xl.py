"""JPEG XL: coded by OpenImageIO, which writes no Exif into it; the label lies beside as an XMP packet."""

import struct
from fractions import Fraction
from pathlib import Path
from xml.sax.saxutils import quoteattr

from l3cli.io.pictures import openimageio
from l3cli.io.pictures.registry import NOTHING, Label, Picture

PACKET = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description rdf:about="" xmlns:tiff="http://ns.adobe.com/tiff/1.0/" xmlns:exif="http://ns.adobe.com/exif/1.0/"'
    ' xmlns:exifEX="http://cipa.jp/exif/1.0/"{}/>'
    "</rdf:RDF></x:xmpmeta>"
)


def encode(path: Path, picture: Picture) -> bytes:
    """Return the file of a picture."""
    content = openimageio.encode(path, picture)
    if picture.label == NOTHING:
        return content
    packet = _xmp(picture.label).encode()
    return content + struct.pack(">I4s", 8 + len(packet), b"xml ") + packet  # a box like the others of the file


def _xmp(label: Label) -> str:
    """Return a label as an XMP packet."""
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
    return PACKET.format("".join(f" {name}={quoteattr(text)}" for name, text in texts.items() if text))
