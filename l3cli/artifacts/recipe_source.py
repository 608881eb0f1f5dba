"""A recipe file while it is checked: the data that the checks need, and the key to which an error message refers."""

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

UNIT_SUFFIX = re.compile("_(dn|e|s|nm|um|mm|m)$")  # suffix of a key that states its unit
MIN_LETTERS = 4  # shorter values are too common to find a key by its value
Meaning = tuple[dict[str, Any], list[Fault]]  # interpretation of a recipe, ready for JSON, and the faults in the recipe


@dataclass(frozen=True)
class RecipeSource:
    """A recipe that is being checked, with its file and its camera."""

    path: Path
    content: Mapping[str, Any]
    camera: CameraModel | None  # the camera that the recipe is for, if it is known

    def file(self, name: str) -> Path:
        """Return the path of a file whose name the recipe contains."""
        return self.path.parent / name

    def attempt(self, key: KeyPath | None, work: Callable[..., object], *arguments: object) -> Iterator[Fault]:
        """Yield a fault if `work` raises an error. If `key` is None, the key is found in the error message."""
        try:
            work(*arguments)
        except (L3Error, OSError) as error:  # OSError if a name is too long, or if a folder cannot be read
            message = self.plain(error)
            yield Fault(message, (key_in(message, self.content) if key is None else key,))

    @contextlib.contextmanager
    def noting(self, faults: list[Fault], *keys: KeyPath) -> Iterator[None]:
        """Append a fault to `faults` if the block raises an error. The fault is reported at the first of the `keys`."""
        try:
            yield
        except (L3Error, OSError) as error:
            faults.append(Fault(self.plain(error), keys))

    def plain(self, error: L3Error | OSError) -> str:
        """Return the message of an error without the name of the recipe file."""
        if isinstance(error, OSError):
            return f"{shortened(str(error.filename))}: {error.strerror}; specify another file"
        return re.sub(rf"^{re.escape(str(self.path))}(:\d+)?: ", "", str(error))


def key_in(message: str, content: Mapping[str, Any]) -> KeyPath:
    """Return the key of a recipe to which a message refers, or () if there is none.

    A message refers to a key if it contains the name of the key or, if no name matches, the value of the key, such as a
    file name.
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
    """Yield the path and the value of every key in a recipe, and of every entry in its lists."""
    inner = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list) else ()
    for key, item in inner:
        yield (*path, key), item
        yield from keys_of(item, (*path, key))
