"""What the file of a rendered frame says of itself beside its pixels; nothing of it depends on when or where it was made."""

from dataclasses import dataclass

from l3cli import __version__
from l3cli.frame import Shot


@dataclass(frozen=True)
class Label:
    """How the frame was taken, and what its picture was made from."""

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


NOTHING = Label()


def of_file(digest: str) -> str:
    """The frame that a raw file holds alone, by the file's SHA-256."""
    return f"raw file SHA-256 {digest}"


def of_values(digest: str) -> str:
    """A frame of a stack or stream, by the SHA-256 of its values, row by row, 16 bits, lower byte first."""
    return f"raw values SHA-256 {digest}"
