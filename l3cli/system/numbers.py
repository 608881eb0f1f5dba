"""Numbers as people write them, in options, variables of the environment and names: plain, finite, within a declared range.

Python takes more for numbers than people mean: 1_000, nan, digits of every script.
"""

import re
from dataclasses import dataclass

from l3cli.errors import shortened

DECIMAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", re.ASCII | re.IGNORECASE)
WHOLE = re.compile(r"([+-]?)0*(\d+)", re.ASCII)
MOST_DIGITS = 40  # of a whole number: more are beyond every range, and Python reads only so many
LARGEST_WHOLE = 2**63 - 1  # what TOML, HDF5 and numpy can hold


class NoSuchNumber(ValueError):
    """A text is no number, or one out of its range; the message says what would be right."""


@dataclass(frozen=True)
class Quantity:
    """Range of a number, ends included, and its unit."""

    least: float
    most: float
    unit: str = ""
    whole: bool = False

    def __str__(self) -> str:
        return f"{_written(self.least)}…{_written(self.most)}{' ' if self.unit else ''}{self.unit}"

    def read(self, text: str) -> float:
        """Return the number that `text` means, an int where it is a whole one; NoSuchNumber if it means none within the
        range."""
        spelled = WHOLE if self.whole else DECIMAL
        if not spelled.fullmatch(text):
            what = "whole number" if self.whole and DECIMAL.fullmatch(text) else "number"
            raise NoSuchNumber(f'"{shortened(text)}" is no {what}; give one within {self}')
        number = _whole(text) if self.whole else float(text) + 0.0  # no -0
        if not self.least <= number <= self.most:
            nearest = self.least if number < self.least else self.most
            raise NoSuchNumber(f"{shortened(text)} is not within {self}; the nearest is {_written(nearest)}")
        return number


def _whole(text: str) -> float:
    """Return an int, or an infinity where it has more digits than Python reads."""
    match = WHOLE.fullmatch(text)
    assert match is not None
    sign, digits = match.groups()
    return int(sign + digits) if len(digits) <= MOST_DIGITS else float(f"{sign}inf")


def _written(number: float) -> str:
    return str(number) if isinstance(number, int) else f"{number:g}"
