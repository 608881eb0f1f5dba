"""What can be taken from a page as a file: the data of its drawings. A script turns drawings into files (downloads.js)."""

import base64
import csv
import io
import re

from l3cli.report.parts import Data

FORMULAS = ("=", "+", "-", "@", "\t", "\r")  # with which spreadsheets take a text for something to compute
LONGEST = 60  # letters of a file's name


def file_stem(title: str) -> str:
    """A title as the name of a file on any system."""
    return re.sub("[^a-z0-9]+", "-", title.lower())[:LONGEST].strip("-") or "figure"


def csv_uri(data: Data) -> str:
    """The data as a CSV file inside a data URI. Texts that a spreadsheet would compute begin with a space."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for row in (data.headings, *data.rows):
        writer.writerow([_harmless(cell) if isinstance(cell, str) else f"{cell:.9g}" for cell in row])
    return "data:text/csv;charset=utf-8;base64," + base64.b64encode(text.getvalue().encode()).decode()


def _harmless(text: str) -> str:
    return f" {text}" if text.startswith(FORMULAS) else text
