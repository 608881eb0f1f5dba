"""A recipe file while it is checked: what the checks need, and the key that an error message is about."""

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

UNIT_SUFFIX = re.compile("_(dn|e|s|nm|um|mm|m)$")  # of a key
MIN_LETTERS = 4  # shorter texts are too common to identify a key by its value
Meaning = tuple[dict[str, Any], list[Fault]]  # what a recipe means, ready for JSON, and faults found on the way


@dataclass(frozen=True)
class RecipeSource:
    """A recipe that is being checked, with its file and the camera it is for."""

    path: Path
    content: Mapping[str, Any]
    camera: CameraModel | None  # the camera that the recipe is for, if it is known

    def file(self, name: str) -> Path:
        """Return the path of a file that the recipe names."""
        return self.path.parent / name

    def attempt(self, key: KeyPath | None, work: Callable[..., object], *arguments: object) -> Iterator[Fault]:
        """Yield a fault if `work` fails. Without `key`, the message decides which key the fault belongs to."""
        try:
            work(*arguments)
        except (L3Error, OSError) as error:  # OSError: a name that is too long, or a folder without read permission
            message = self.plain(error)
            yield Fault(message, (key_in(message, self.content) if key is None else key,))

    @contextlib.contextmanager
    def noting(self, faults: list[Fault], *keys: KeyPath) -> Iterator[None]:
        """Append a fault of the `keys` to `faults` if the block fails. It is reported at the first key."""
        try:
            yield
        except (L3Error, OSError) as error:
            faults.append(Fault(self.plain(error), keys))

    def plain(self, error: L3Error | OSError) -> str:
        """Return the message of an error without the name of this file."""
        if isinstance(error, OSError):
            return f"{shortened(str(error.filename))}: {error.strerror}; name another file"
        return re.sub(rf"^{re.escape(str(self.path))}(:\d+)?: ", "", str(error))


def key_in(message: str, content: Mapping[str, Any]) -> KeyPath:
    """Return the key of a recipe that a message is about, or () if there is none.

    A message is about a key if it contains the key's name or, failing that, the key's text, such as the name of a file.
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
    """Yield the path and value of every key of a recipe, and of every entry of its lists."""
    inner = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list) else ()
    for key, item in inner:
        yield (*path, key), item
        yield from keys_of(item, (*path, key))
