"""A recipe as a file: what judges are given of it, and the key that an error in it is about."""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from l3cli.artifacts.camera import CameraModel
from l3cli.errors import L3Error, shortened
from l3cli.recipes.faults import Fault
from l3cli.recipes.toml import KeyPath

SUFFIX = re.compile("_(dn|e|s|nm|um|mm|m)$")  # of a key with a unit
SHORTEST = 4  # letters of a text that an error is known by
Meaning = tuple[dict[str, Any], list[Fault]]  # of a recipe, ready for JSON, and faults that show only there


@dataclass(frozen=True)
class RecipeSource:
    """A recipe that is checked, and what it is checked with."""

    path: Path
    content: Mapping[str, Any]
    camera: CameraModel | None  # that the recipe is for, if one is given

    def file(self, name: str) -> Path:
        """Return a file that the recipe names."""
        return self.path.parent / name

    def attempt(self, key: KeyPath | None, work: Callable[..., object], *arguments: object) -> Iterator[Fault]:
        """Yield the fault, if there is one, with which `work` fails: at `key`, or where its message belongs."""
        try:
            work(*arguments)
        except (L3Error, OSError) as error:  # a name that is too long, a folder that must not be read
            message = self.plain(error)
            yield Fault(message, (key_in(message, self.content) if key is None else key,))

    def plain(self, error: L3Error | OSError) -> str:
        """Return an error's message without the name of this file."""
        if isinstance(error, OSError):
            return f"{shortened(str(error.filename))}: {error.strerror}; name another file"
        return re.sub(rf"^{re.escape(str(self.path))}(:\d+)?: ", "", str(error))


def key_in(message: str, content: Mapping[str, Any]) -> KeyPath:
    """Return the key that a message is about: whose name, or else whose text (that of a file, say) it holds; () where there
    is none."""
    found: list[tuple[int, KeyPath]] = []
    for path, value in keys_of(content):
        names = [part for part in path if isinstance(part, str)]
        last = names[-1] if isinstance(path[-1], str) else ""
        if len(names) > 1 and ".".join(names) in message:
            found.append((200 + len(names), path))
        elif isinstance(value, str) and len(value) >= SHORTEST and value in message:
            found.append((100, path))
        elif last and re.search(rf"\b({re.escape(last)}|{re.escape(SUFFIX.sub('', last).replace('_', ' '))})\b", message):
            found.append((len(last), path))
    return max(found, key=lambda each: each[0])[1] if found else ()


def keys_of(value: Any, path: KeyPath = ()) -> Iterator[tuple[KeyPath, Any]]:
    """Yield the place and value of every key of a recipe, and of every entry of its lists."""
    inner = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list) else ()
    for key, item in inner:
        yield (*path, key), item
        yield from keys_of(item, (*path, key))
