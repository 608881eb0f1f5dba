"""Generate the list of the licences of all dependencies, as stated by the installed packages."""

import re
from importlib.metadata import PackageMetadata, PackageNotFoundError, distribution, requires

from markup import code, page, plain, table
from packaging.requirements import Requirement

EXTRAS = ("video", "fits", "cluster", "menon")
INTRO = (
    "This page lists the packages that are installed together with l3cli, and the licence that each package states. If an "
    "extra requires the package, the extra is in brackets. The versions are those with which this page was built. None of "
    "these packages is part of l3cli."
)


def licence_pages() -> dict[str, str]:
    found: dict[str, str] = {}
    for extra in ("", *EXTRAS):
        for name in needed("l3cli", extra, set()):
            found.setdefault(name, extra)
    rows = [(code(name) + (f" ({extra})" if extra else ""), *stated(name)) for name, extra in sorted(found.items())]
    return {"licences.md": page("# Licences of dependencies", INTRO, table(["package", "version", "licence"], rows))}


def needed(name: str, extra: str, seen: set[tuple[str, str]]) -> list[str]:
    """Return the names of all installed packages on which a package depends, directly or indirectly."""
    found: list[str] = []
    for line in requires(name) or []:
        need = Requirement(line)
        wanted = need.marker is None or need.marker.evaluate({"extra": extra})
        if not wanted or (extra and need.marker is None):
            continue
        place = re.sub(r"[-_.]+", "-", need.name).lower()
        for each in ("", *need.extras):
            if (place, each) not in seen and installed(place):
                seen.add((place, each))
                found += [place, *needed(place, each, seen)]
    return found


def installed(name: str) -> bool:
    try:
        distribution(name)
    except PackageNotFoundError:
        return False
    return True


def stated(name: str) -> tuple[str, str]:
    """Return version and licence of a package: its SPDX expression, its classifiers, or the first line of its text."""
    known = distribution(name).metadata
    classes = [each.rpartition(" :: ")[2] for each in known.get_all("Classifier", []) if each.startswith("License :: OSI")]
    text = _one(known, "License-Expression") or ", ".join(classes) or _one(known, "License").strip().partition("\n")[0]
    return known["Version"], plain(text) or "not stated by the package"


def _one(known: PackageMetadata, name: str) -> str:
    """Return a metadata entry of a package, or an empty text if the entry is missing."""
    return (known.get_all(name) or [""])[0]
