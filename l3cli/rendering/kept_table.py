"""Tables as they are rendered by, kept from run to run.

To unpack a table's weights, to check them and to lay them out as kernels read them takes longer than to render a frame. So
its fields, and the arrays that a renderer has made of them, are kept beside the compiled kernels, uncompressed, in one file
(l3cli/kept.py) known by the SHA-256 of the table's file and by what of l3 makes them. As many bytes of such files stay as
MOST; a table of more is unpacked in every run.
"""

import contextlib
import dataclasses
import functools
import hashlib
import json
import math
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli import __version__
from l3cli.artifacts.schema import Spec, Stage, declared, instances
from l3cli.artifacts.table import TransformTable
from l3cli.errors import L3Error
from l3cli.files import sha256
from l3cli.kept import forget_oldest, kept_folder, read_kept, write_kept

MOST = 512 << 20  # bytes of all tables that are kept
MOST_ONE = 128 << 20  # of one of them
SUFFIX = ".table"
ALIGNMENT = 64  # bytes
LENGTH = 8  # bytes that hold one
Arrays = dict[str, tuple[NDArray, ...]]  # by name
MAKERS = ("artifacts", "classes", "rendering")  # folders of l3cli whose modules decide what is kept


class Layouts:
    """Arrays made of a table, by name: those that are kept, and new ones."""

    def __init__(self, kept: Arrays | None = None) -> None:
        self._arrays = kept or {}
        self.has_news = False

    def of(self, name: str, make: Callable[[], Iterable[NDArray]]) -> tuple[NDArray, ...]:
        """The arrays of a name; make() where they are not kept. All that they depend on beside the table is in the name."""
        if name not in self._arrays:
            self._arrays[name] = tuple(make())
            self.has_news = True
        return self._arrays[name]

    def all(self) -> Arrays:
        """By name."""
        return self._arrays


@dataclass(frozen=True)
class OpenTable:
    """A table, the SHA-256 of its file, and what has been made of it."""

    table: TransformTable
    digest: str
    layouts: Layouts
    file: Path | None = None  # where it is kept

    def keep(self) -> None:
        """Keep it, if anything new has been made; not where that cannot be."""
        if self.file is None or not self.layouts.has_news:
            return
        self.layouts.has_news = False
        try:
            parts = list(_parts(self.table, self.layouts.all()))
            if sum(map(len, parts)) <= MOST_ONE:
                write_kept(self.file, parts)
                forget_oldest(self.file.parent, SUFFIX, MOST)
        except (L3Error, OSError):
            pass  # it is made anew each time, with the same pictures


def open_table(path: Path) -> OpenTable:
    """The table in a file, checked as by `load`: now, or before it was kept."""
    before = sha256(path) if path.is_file() else ""
    file = _file_of(before)
    content = None if file is None else read_kept(file, MOST_ONE)
    if content is not None and file is not None:
        _mark_as_used(file)
        table, layouts = _taken_apart(content)
        return OpenTable(table, before, Layouts(layouts), file)
    from l3cli.artifacts.store import load

    table = load(TransformTable, path)
    digest = sha256(path)
    return OpenTable(table, digest, Layouts(), file if digest == before else None)  # or else it was replaced meanwhile


def _file_of(digest: str) -> Path | None:
    folder, makers = kept_folder(), _makers()
    if folder is None or not makers or not digest:
        return None
    return folder / f"{hashlib.sha256(f'{digest} {makers}'.encode()).hexdigest()}{SUFFIX}"


@functools.cache
def _makers() -> str:
    """What tells one state of l3's code from another; empty if that cannot be told."""
    package, found = Path(__file__).parents[1], [__version__, np.dtype(np.int16).newbyteorder("=").str]
    try:
        for name in MAKERS:
            for each in sorted(os.scandir(package / name), key=lambda each: each.name):
                if each.name.endswith(".py"):
                    state = each.stat()
                    found.append(f"{name}/{each.name} {state.st_size} {state.st_mtime_ns}")
    except OSError:
        return ""  # it is in an archive
    return "\n".join(found)


def _mark_as_used(file: Path) -> None:
    with contextlib.suppress(OSError):  # the system's, or on a disk that is read only
        os.utime(file)


# ------------------------------------------------------------------------------------------------------- content


def _parts(table: TransformTable, layouts: Arrays) -> Iterator[bytes | memoryview]:
    """What a table and its layouts are kept as: the length of a description in JSON, it, and the arrays."""
    arrays: list[NDArray] = []

    def described(value: Any) -> Any:
        if not isinstance(value, np.ndarray):
            return value
        arrays.append(np.ascontiguousarray(value))
        return [value.dtype.str, value.shape]

    description = {
        "history": [dataclasses.asdict(stage) for stage in table.history],
        "arrays": [name for name, value in _fields(table) if isinstance(value, np.ndarray)],
        "fields": {name: described(value) for name, value in _fields(table)},
        "layouts": {name: [described(each) for each in made] for name, made in layouts.items()},
    }
    text = json.dumps(description).encode()
    text += b" " * (-(LENGTH + len(text)) % ALIGNMENT)
    yield len(text).to_bytes(LENGTH, "little")
    yield text
    for array in arrays:
        yield array.reshape(-1).view(np.uint8).data
        yield bytes(-array.nbytes % ALIGNMENT)


def _taken_apart(content: memoryview) -> tuple[TransformTable, Arrays]:
    """The table and the layouts of what `_parts` has made."""
    end = LENGTH + int.from_bytes(content[:LENGTH], "little")
    description = json.loads(bytes(content[LENGTH:end]))

    def next_array(described: tuple[str, list[int]]) -> NDArray:
        nonlocal end
        dtype, shape = described
        array = np.frombuffer(content, dtype, math.prod(shape), end).reshape(shape)
        end += array.nbytes + -array.nbytes % ALIGNMENT
        return array

    arrays = set(description["arrays"])
    fields = {name: next_array(value) if name in arrays else value for name, value in description["fields"].items()}
    layouts = {name: tuple(map(next_array, made)) for name, made in description["layouts"].items()}
    history = tuple(Stage(**stage) for stage in description["history"])
    return _instance(TransformTable, fields, "", history=history), layouts


def _fields(instance: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Name and value of every declared field of an instance and of those below it."""
    for name, spec, _ in declared(type(instance)):
        value = getattr(instance, name)
        if isinstance(spec, Spec):
            yield prefix + name, value
        else:
            for place, each in instances(name, value).items():
                yield from _fields(each, f"{prefix}{place}/")


def _instance(cls: type, fields: dict[str, Any], prefix: str, **others: Any) -> Any:
    """An instance of a dataclass from the fields of a prefix. It was checked before it was kept."""
    made: Any = object.__new__(cls)
    for name, spec, _ in declared(cls):
        place = prefix + name
        if isinstance(spec, Spec):
            value = fields[place]
            value = tuple(value) if spec.axes and spec.dtype == "str" else value
        elif spec.several:
            count = len({each[len(place) + 1 :].partition("/")[0] for each in fields if each.startswith(f"{place}/")})
            value = tuple(_instance(spec.kind, fields, f"{place}/{index}/") for index in range(count))
        else:
            is_there = any(each.startswith(f"{place}/") for each in fields)
            value = _instance(spec.kind, fields, f"{place}/") if is_there else None
        object.__setattr__(made, name, value)
    for name, value in others.items():
        object.__setattr__(made, name, value)
    return made
