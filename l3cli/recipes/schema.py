"""Derive JSON schemas (2020-12) for recipes from their declared types. Editors check TOML files with these schemas."""

import ast
import functools
import inspect
import io
import textwrap
import tokenize
from collections.abc import Sequence
from typing import Any

import msgspec

from l3cli.recipes.toml import Recipe, tables_in

DIALECT = "https://json-schema.org/draft/2020-12/schema"
PLACE = "#/$defs/{name}"


def schema_of(recipes: Sequence[type[Recipe]], title: str) -> dict[str, Any]:
    """Return the JSON schema of a recipe file.

    The description of each key is taken from the comment at its declaration in the source code.

    Parameters
    ----------
    recipes : sequence of type
        Classes that can describe the whole file.
    title : str
        Title of the schema.

    Returns
    -------
    dict
        The schema, which can be written with `json.dumps`.
    """
    roots, tables = msgspec.json.schema_components(recipes, ref_template=PLACE)
    # msgspec names a table after its class, and prepends the module name if several classes have the same name.
    classes = {name: kind for kind in _structures(recipes) for name in (kind.__name__, f"{kind.__module__}.{kind.__name__}")}
    for name, table in tables.items():
        if "description" in table:
            table["description"] = " ".join(table["description"].split())
        meanings: dict[str, str] = {}
        for each in reversed(classes[name].__mro__):
            meanings |= _comments(each) if issubclass(each, Recipe) and each is not Recipe else {}
        for key, value in table.get("properties", {}).items():
            table["properties"][key] = _plain(value) | ({"description": meanings[key]} if key in meanings else {})
    whole: dict[str, Any] = {"$schema": DIALECT, "title": title}
    whole |= roots[0] if len(roots) == 1 else {"anyOf": list(roots)}
    return whole | {"$defs": tables}


def _plain(value: Any) -> Any:
    """Simplify a property's schema: remove null, which TOML lacks, and keywords that older schema versions lack."""
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if not isinstance(value, dict):
        return value
    value = {key: _plain(each) for key, each in value.items() if not (key == "default" and each is None)}
    if {"type": "null"} in value.get("anyOf", []):
        kinds = [each for each in value.pop("anyOf") if each != {"type": "null"}]
        value = (kinds[0] if len(kinds) == 1 else {"anyOf": kinds}) | value
    first, *others = value.get("prefixItems", [None])
    if first is not None and all(each == first for each in others):  # all entries of the tuple have the same type
        del value["prefixItems"]
        value["items"] = first
    return value


def _structures(recipes: Sequence[type[Recipe]]) -> list[type[Recipe]]:
    """Return the classes in `recipes`, and the classes of all tables that these recipes can contain."""
    found = list(recipes)
    for kind in found:  # the loop also visits the classes that it appends
        inner = [each for field in msgspec.structs.fields(kind) for each in tables_in(field.type)]
        found += [each for each in dict.fromkeys(inner) if each not in found]
    return found


@functools.cache
def _comments(kind: type) -> dict[str, str]:
    """Return the comment on each key that a class declares, from the lines above the declaration or the ends of its lines.

    The result is empty if the source code is not available.
    """
    try:
        source = textwrap.dedent(inspect.getsource(kind))
    except (OSError, TypeError):
        return {}
    lines, own = _comment_lines(source), {}
    (tree,) = ast.parse(source).body
    for node in getattr(tree, "body", []):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            above = node.lineno
            while lines.get(above - 1, (False, ""))[0]:
                above -= 1
            texts = [lines[line][1] for line in range(above, (node.end_lineno or node.lineno) + 1) if line in lines]
            if texts:
                own[node.target.id] = " ".join(texts)
    return own


def _comment_lines(source: str) -> dict[int, tuple[bool, str]]:
    """Return (whether the line contains nothing but the comment, comment text) for each line with a comment."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return {
        token.start[0]: (token.line.strip().startswith("#"), token.string.lstrip("# "))
        for token in tokens
        if token.type == tokenize.COMMENT and not token.string.startswith("# fmt")
    }
