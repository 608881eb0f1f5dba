"""Generate pages with the keys of every type of recipe, from the JSON schemas that `l3 schema` prints."""

import json
from collections.abc import Iterator
from typing import Any

from markup import code, page, plain, table

from l3cli.physics.spectra import illuminant_names
from l3cli.stages.check import KINDS, schema

INTRO = (
    "These pages are for looking up the keys of recipes. They are generated from the types with which l3 checks recipes. "
    "[Recipes](../commands.md#recipes) explains each kind of recipe. `l3 schema` prints the same keys for editors."
)


def recipe_pages() -> dict[str, str]:
    schemas = {kind: (f"{KINDS[kind].title.removeprefix('a ')}s", schema(kind)) for kind in KINDS}
    pages = {f"{kind}.md": recipe_page(*each) for kind, each in schemas.items()}
    tree = "\n".join(["```{toctree}", *schemas, "```"])
    return pages | {"recipes.md": page("# Recipes by key", INTRO, tree, "## Illuminants", lights())}


def lights() -> str:
    return f"These illuminants have names: {', '.join(code(name) for name in illuminant_names())}."


def recipe_page(kinds: str, whole: dict[str, Any]) -> str:
    places: dict[str, list[str]] = {}
    roots = list(references(whole))
    for root in roots:
        _place(whole["$defs"], root, "", False, places)
    usual = whole["$defs"][roots[0]]["properties"]
    tops = {root: [key for key in whole["$defs"][root]["required"] if key not in usual] for root in roots}
    return page(f"# Keys of {kinds}", *(section(whole["$defs"][name], places[name], tops.get(name, [])) for name in places))


def references(value: Any) -> Iterator[str]:
    """Yield the names of the tables to which a schema value refers."""
    if isinstance(value, dict):
        if "$ref" in value:
            yield value["$ref"].rpartition("/")[2]
        for key in ("items", "additionalProperties", "anyOf"):
            yield from references(value.get(key))
    elif isinstance(value, list):
        for each in value:
            yield from references(each)


def _place(tables: dict[str, Any], name: str, path: str, several: bool, places: dict[str, list[str]]) -> None:
    """Collect the TOML headings of each table, such as [lens] or [[scene]], in the order of the declarations."""
    heading = "" if not path else f"[[{path}]]" if several else f"[{path}]"
    known = places.setdefault(name, [])
    if heading in known:
        return
    known.append(heading)
    for key, value in tables[name]["properties"].items():
        for each in references(value):
            _place(tables, each, f"{path}.{key}" if path else key, value.get("type") == "array", places)


def section(declared: dict[str, Any], places: list[str], needed: list[str]) -> str:
    """Return the section of a TOML table. `needed` are keys that distinguish tables with the same heading."""
    rows, kinds = [], []
    for key, value in declared["properties"].items():
        if len(value.get("enum", [])) == 1 and "default" not in value:
            kinds.append(f"{key} = {json.dumps(value['enum'][0])}")  # the key that distinguishes tables with the same name
        else:
            rows.append((code(key), words(value), default(key, value, declared), plain(value.get("description", ""))))
    heading = ", ".join(map(code, filter(None, places))) or "At the top of the file"
    heading += f" that has {', '.join(map(code, needed))}" if needed else ""
    heading += "".join(f" with {code(kind)}" for kind in kinds)
    about = plain(declared.get("description", ""))
    keys = table(["key", "value", "default", "meaning"], rows) if rows else "No further keys."
    return page(f"## {heading}", about, keys).rstrip()


def default(key: str, value: dict[str, Any], declared: dict[str, Any]) -> str:
    if key in declared.get("required", []):
        return "required"
    return code(json.dumps(value["default"], ensure_ascii=False)) if value.get("default") not in (None, [], {}) else "—"


NAMES = {"string": "text", "integer": "whole number", "number": "number", "boolean": "true or false", "object": "table"}


def words(value: dict[str, Any]) -> str:
    """Describe a schema type in words."""
    if "$ref" in value:
        return "table"
    if "enum" in value:
        return " or ".join(code(json.dumps(each)) for each in value["enum"])
    if "anyOf" in value:
        return " or ".join(dict.fromkeys(map(words, value["anyOf"])))
    if value.get("type") == "array":
        count = f"{value['minItems']} " if value.get("minItems") and value["minItems"] == value.get("maxItems") else ""
        inner = words(value.get("items", {}))
        if inner == "table":
            return f"{count}tables"
        return f"list of {count}{inner.replace('number', 'numbers', 1)}"
    if value.get("type") == "object" and "additionalProperties" in value:
        return f"table of {words(value['additionalProperties'])}"
    return NAMES.get(value.get("type", ""), "any") + limits(value)


def limits(value: dict[str, Any]) -> str:
    if "exclusiveMinimum" in value:
        return f" above {value['exclusiveMinimum']:g}"
    if "minimum" in value and value.get("maximum", 2**62) < 2**62:
        return f" {value['minimum']}…{value['maximum']}"
    return f" from {value['minimum']:g}" if "minimum" in value else ""
