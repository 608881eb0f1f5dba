"""The tags and text of a report page."""

import base64
import csv
import html.parser
from pathlib import Path


class Tags(html.parser.HTMLParser):
    """Start tags in order, with their attributes, and all text of a page."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.starts: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(page.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.starts.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text += data

    def all(self, *tags: str) -> list[dict[str, str | None]]:
        """Return the attributes of all tags with these names."""
        return [attributes for tag, attributes in self.starts if tag in tags]


def csv_rows(uri: str) -> list[list[str]]:
    """Return the rows of a CSV file in a data URI."""
    head, _, body = uri.partition(",")
    assert head == "data:text/csv;charset=utf-8;base64"
    return list(csv.reader(base64.b64decode(body).decode().splitlines()))
