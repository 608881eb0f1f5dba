"""Lines of keys: every key of every text that tomllib reads, where it stands."""

import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from l3cli.recipes.toml import KeyPath, key_lines, line_of
from tests.helpers.paths import CONFIGS


def paths(content: Any, path: KeyPath = ()) -> set[KeyPath]:
    """Every key, table and entry of what tomllib has read."""
    inner = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    return {path}.union(*(paths(value, (*path, key)) for key, value in inner)) - {()}


NAMES = st.one_of(
    st.text("ab_-1", min_size=1, max_size=3), st.sampled_from(['"a.b"', "'#'", '"\\u0041\\n"', '"[x]"', "'='", '""'])
)
SCALARS = st.sampled_from([
    "1", "-2.5e3", "true", "1979-05-27 07:32:00", "1979-05-27T07:32:00Z", "inf", '"a # b"', "'c = [1'", '"\\"}"',
    '"""x\ny"""', '"""a""b\\""""', "'''\n[t]\nk = 1\n'''", '""', "''", '""""a"""""', "''''b'''''", '"""\\\n  z"""',
])  # fmt: skip
BLANKS = st.sampled_from(["", " ", "\t"])
BREAKS = st.sampled_from(["", " ", "\n", ' # ] } "\n', "\n\n"])


@st.composite
def lists(draw: st.DrawFn, values: st.SearchStrategy[str]) -> str:
    items = [draw(BREAKS) + each + draw(BREAKS) for each in draw(st.lists(values, max_size=3))]
    return f"[{','.join(items)}{draw(st.sampled_from(['', ','])) if items else ''}{draw(BREAKS)}]"


@st.composite
def inline_tables(draw: st.DrawFn, values: st.SearchStrategy[str]) -> str:
    return "{" + ", ".join(f"{draw(keys())} = {each}" for each in draw(st.lists(values, max_size=3))) + draw(BLANKS) + "}"


@st.composite
def keys(draw: st.DrawFn) -> str:
    return f"{draw(BLANKS)}.{draw(BLANKS)}".join(draw(st.lists(NAMES, min_size=1, max_size=3)))


VALUES = st.recursive(SCALARS, lambda values: lists(values) | inline_tables(values), max_leaves=6)


@st.composite
def texts(draw: st.DrawFn) -> str:
    """Statements of TOML, many of which contradict each other."""
    lines = []
    for _ in range(draw(st.integers(0, 7))):
        kind, key = draw(st.sampled_from("tap")), draw(keys())
        statement = {"t": f"[{key}]", "a": f"[[{key}]]"}.get(kind) or f"{key} = {draw(VALUES)}"
        lines.append(
            draw(BLANKS) + statement + draw(st.sampled_from(["", "  # [no]", " "])) + draw(st.sampled_from(["\n", "\n\n"]))
        )
    return "".join(lines)


@settings(max_examples=250, deadline=None)
@given(texts())
def test_every_key_that_tomllib_reads_has_a_line(text: str) -> None:
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return
    assert set(key_lines(text)) == paths(content)
    assert key_lines(text.replace("\n", "\r\n")) == key_lines(text)


@settings(max_examples=150, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(["k", "t", "a", "d"]), VALUES, BREAKS), max_size=8))
def test_a_key_is_in_the_line_where_it_is_written(parts: list[tuple[str, str, str]]) -> None:
    text, entries = "", 0
    table: KeyPath = ()
    expected: dict[KeyPath, int] = {}
    for number, (kind, value, gap) in enumerate(parts):
        text += gap + "\n"
        line = text.count("\n") + 1
        if kind == "t":
            table, text = (f"t{number}",), text + f"[t{number}]\n"
            expected[table] = line
        elif kind == "a":
            table, text, entries = ("list", entries), text + "[[list]]\n", entries + 1
            expected[table] = line
        elif kind == "d":
            text += f"d{number}.'in' . side = {value}\n"
            expected[*table, f"d{number}", "in", "side"] = line
        else:
            text += f'"k{number}" = [\n  {value},\n]\n'
            expected[*table, f"k{number}"], expected[*table, f"k{number}", 0] = line, line + 1
    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError:  # of a comment without its end, or two equal keys of a table
        return
    found = key_lines(text)
    assert {path: found[path] for path in expected} == expected


@pytest.mark.parametrize("path", sorted(CONFIGS.rglob("*.toml")), ids=lambda path: path.stem)
def test_shipped_recipes(path: Path) -> None:
    text = path.read_text()
    lines, shown = key_lines(text), text.splitlines()
    assert set(lines) == paths(tomllib.loads(text))
    named = {path: line for path, line in lines.items() if isinstance(path[-1], str)}
    assert all(str(path[-1]) in shown[line - 1] for path, line in named.items())


def test_what_is_missing_is_where_it_ought_to_be() -> None:
    lines = key_lines('name = "x"\n[a]\nb = 1\n[[c]]\nd = 2\n[[c]]\n[c.e]\nf = { g = 3 }\n')
    assert line_of(("a", "b"), lines) == 3
    assert line_of(("a", "missing"), lines) == 2
    assert line_of(("c", 1, "e", "f", "g"), lines) == 8
    assert line_of(("c", 1, "d"), lines) == 6
    assert line_of(("missing", 3, "d"), lines) == 1
