"""Tools for recipe checks: the recipe with its context, and a search for the key that caused an error."""

import contextlib
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from l3cli.artifacts.camera import CameraModel
from l3cli.errors import L3Error, shortened
from l3cli.recipes.faults import Fault
from l3cli.recipes.toml import KeyPath

UNIT_SUFFIX = re.compile("_(dn|e|s|nm|um|mm|m)$")  # unit at the end of a key
MIN_LETTERS = 4  # shorter values may occur in a message by chance, so they do not identify a key
Meaning = tuple[dict[str, Any], list[Fault]]  # l3's interpretation of a recipe, ready for JSON, and the recipe's faults


@dataclass(frozen=True)
class RecipeSource:
    """A recipe to be checked, with its path, its parsed content and the camera that will use it."""

    path: Path
    content: Mapping[str, Any]
    camera: CameraModel | None  # None if the camera is unknown

    def file(self, name: str) -> Path:
        """Resolve a file name in the recipe. File names are relative to the recipe's folder."""
        return self.path.parent / name

    def attempt(self, key: KeyPath | None, work: Callable[..., object], *arguments: object) -> Iterator[Fault]:
        """Call `work(*arguments)`, and convert an error to a fault of `key`.

        If `key` is None, the error message is searched for the key (see `key_in`).
        """
        try:
            work(*arguments)
        except (L3Error, OSError) as error:  # OSError: a file name is too long, or a folder cannot be read
            message = self.plain(error)
            yield Fault(message, (key_in(message, self.content) if key is None else key,))

    @contextlib.contextmanager
    def noting(self, faults: list[Fault], *keys: KeyPath) -> Iterator[None]:
        """Convert an error in a `with` block to a fault, and append it to `faults`.

        The fault refers to the first of `keys` that the recipe contains.
        """
        try:
            yield
        except (L3Error, OSError) as error:
            faults.append(Fault(self.plain(error), keys))

    def plain(self, error: L3Error | OSError) -> str:
        """Return the error message without the recipe's path at its start."""
        if isinstance(error, OSError):
            return f"{shortened(str(error.filename))}: {error.strerror}; specify a different file"
        return re.sub(rf"^{re.escape(str(self.path))}(:\d+)?: ", "", str(error))


def key_in(message: str, content: Mapping[str, Any]) -> KeyPath:
    """Find the recipe key to which an error message refers. Returns () if no key matches.

    A key matches if the message contains the key's name or value, for example a file name. Among several matches, dotted
    names have the highest priority, followed by values and then by the longest name.
    """
    found: list[tuple[int, KeyPath]] = []
    for path, value in keys_of(content):
        names = [part for part in path if isinstance(part, str)]
        last = names[-1] if isinstance(path[-1], str) else ""
        if len(names) > 1 and ".".join(names) in message:
            found.append((200 + len(names), path))
        elif isinstance(value, str) and len(value) >= MIN_LETTERS and value in message:
            found.append((100, path))
        elif last and re.search(
            rf"\b({re.escape(last)}|{re.escape(UNIT_SUFFIX.sub('', last).replace('_', ' '))})\b", message
        ):
            found.append((len(last), path))
    return max(found, key=lambda each: each[0])[1] if found else ()


def keys_of(value: Any, path: KeyPath = ()) -> Iterator[tuple[KeyPath, Any]]:
    """Iterate over all keys and list elements of a recipe, each with its path and value. Parents come first."""
    inner = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list) else ()
    for key, item in inner:
        yield (*path, key), item
        yield from keys_of(item, (*path, key))
