"""JSON schemas (2020-12) of recipes, derived from the declared types, for editors that check TOML."""

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
    """Return the schema of a file that is one of `recipes`.

    The description of a key is the comment beside its declaration.

    Parameters
    ----------
    recipes : sequence of type
        Structures that the file may have.
    title : str
        Title of the schema.

    Returns
    -------
    dict
        The schema, ready for JSON.
    """
    roots, tables = msgspec.json.schema_components(recipes, ref_template=PLACE)
    # msgspec names a structure by its class, and by module and class if several classes have the name.
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
    """Return a property without null, which TOML does not have, and in terms that older schema dialects share."""
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if not isinstance(value, dict):
        return value
    value = {key: _plain(each) for key, each in value.items() if not (key == "default" and each is None)}
    if {"type": "null"} in value.get("anyOf", []):
        kinds = [each for each in value.pop("anyOf") if each != {"type": "null"}]
        value = (kinds[0] if len(kinds) == 1 else {"anyOf": kinds}) | value
    first, *others = value.get("prefixItems", [None])
    if first is not None and all(each == first for each in others):  # a tuple of equal types
        del value["prefixItems"]
        value["items"] = first
    return value


def _structures(recipes: Sequence[type[Recipe]]) -> list[type[Recipe]]:
    """Return all structures that the recipes contain."""
    found = list(recipes)
    for kind in found:  # the list grows while it is read
        inner = [each for field in msgspec.structs.fields(kind) for each in tables_in(field.type)]
        found += [each for each in dict.fromkeys(inner) if each not in found]
    return found


@functools.cache
def _comments(kind: type) -> dict[str, str]:
    """Return the comment of each key of a structure: above its declaration, or at the ends of its lines."""
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
    """Return the comment of each line that has one, and whether the line holds nothing else."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return {
        token.start[0]: (token.line.strip().startswith("#"), token.string.lstrip("# "))
        for token in tokens
        if token.type == tokenize.COMMENT and not token.string.startswith("# fmt")
    }
