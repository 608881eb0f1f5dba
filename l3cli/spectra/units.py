"""Parse units such as "W/(sr m² nm)", "µm" or "ms", and convert them to the units in which l3 computes."""

import re
from dataclasses import dataclass

PREFIXES = {"": 1.0, "k": 1e3, "m": 1e-3, "u": 1e-6, "n": 1e-9, "p": 1e-12}
BASES = {
    **{prefix + "W": (scale, {"J": 1, "s": -1}) for prefix, scale in PREFIXES.items()},
    **{prefix + "J": (scale, {"J": 1}) for prefix, scale in PREFIXES.items()},
    **{prefix + "A": (scale, {"A": 1}) for prefix, scale in PREFIXES.items()},
    **{prefix + "V": (scale, {"V": 1}) for prefix, scale in PREFIXES.items()},
    **{prefix + "s": (scale, {"s": 1}) for prefix, scale in PREFIXES.items()},
    **{prefix + "m": (scale, {"m": 1}) for prefix, scale in PREFIXES.items()},
    **{name: (1.0, {"J": 1, "s": -1}) for name in ("watt", "watts")},
    **{name: (1.0, {"photon": 1}) for name in ("photon", "photons", "ph", "quanta", "quantum")},
    **{name: (1.0, {"electron": 1}) for name in ("electron", "electrons", "e-")},
    **{name: (1.0, {"s": 1}) for name in ("sec", "second", "seconds")},
    **{name: (1e-10, {"m": 1}) for name in ("angstrom", "angstroms")},
    **{name: (1e-6, {"m": 1}) for name in ("micron", "microns", "micrometer", "micrometers", "micrometre", "micrometres")},
    **{name: (1e-9, {"m": 1}) for name in ("nanometer", "nanometers", "nanometre", "nanometres")},
    "cm": (1e-2, {"m": 1}),
    "sr": (1.0, {"sr": 1}),
    "DN": (1.0, {"DN": 1}),
    **{name: (1e-2, {}) for name in ("%", "percent", "pct")},
    "1": (1.0, {}),
}
SPELLINGS = {
    **dict.fromkeys("·⋅*×", " "),
    **dict.fromkeys("µμ", "u"),
    **dict.fromkeys("ÅÅ", "angstrom"),
    **{high: f"^{low}" for high, low in zip("⁰¹²³⁴⁵⁶⁷⁸⁹", "0123456789", strict=True)},
    "⁻": "^-",
    "−": "-",
}
TOKEN = re.compile(r"\s*(?:(?P<name>e-(?!\d)|[A-Za-z]+|%|(?<![\w^])1(?!\d))|(?P<power>\^?-?\d)|(?P<sign>[()/]))\s*")
# Units of raw readings, which include the response of the instrument.
RAW = re.compile(r"(?:counts?|cts|adu|dn|dbm?|[mu]?v)(?:/(?:s|ms|us|nm))?", re.I)
RAW_LAST = re.compile(r"(?:^|[\s_,])(counts?|cts|adu|dbm?|mv)$", re.I)  # unit of raw readings without brackets, at the end
FRACTION_UNITS = ("reflectance", "transmittance")  # "units" of columns with fractions from 0 to 1
RELATIVE_UNITS = ("a.u.", "au", "arb. units", "relative", "rel.", "rel")  # "units" of columns without an absolute scale
MAX_UNIT_CHARACTERS = 80  # length above which a text is not parsed as a unit
PHOTON_RADIANCE, POWER_RADIANCE = "photons/s/sr/m²/nm", "W/(sr m² nm)"


@dataclass(frozen=True)
class Unit:
    """A unit: a factor times powers of base units (J, photon, electron, s, sr, m, A, V, DN)."""

    scale: float
    powers: dict[str, int]


def parse(text: str) -> Unit | None:
    """Parse a unit in any common spelling, such as "W/(sr m² nm)", or return None if the text is not a unit."""
    if len(text) > MAX_UNIT_CHARACTERS:
        return None
    plain = re.sub(r"\bper\b", "/", "".join(SPELLINGS.get(letter, letter) for letter in text)).replace("^^", "^")
    plain = re.sub(r"\^-\^", "^-", plain).strip()
    plain = re.sub(r"(?<=[a-z0-9])-(?=[a-z])", " ", plain)  # for units such as W/m2-sr-nm
    tokens, at = [], 0
    while at < len(plain):
        token = TOKEN.match(plain, at)
        if token is None:
            return None
        tokens.append(token)
        at = token.end()
    try:
        unit, rest = _product(tokens)
    except (KeyError, IndexError):
        return None
    return unit if tokens and not rest else None


def below_one_slash(text: str) -> str | None:
    """Move everything after a unit's first slash into the denominator: "W/sr·m²/nm" becomes "W/(sr·m² nm)".

    Return None if there is no slash, or nothing but brackets and slashes after it.
    """
    above, slash, below = text.partition("/")
    plain = re.sub(r"[/()]", " ", below)
    return f"{above}/({plain})" if slash and plain.strip() else None


def _product(tokens: list[re.Match[str]]) -> tuple[Unit, list[re.Match[str]]]:
    """Parse tokens up to an unmatched closing bracket or to the end. Return the unit and the remaining tokens.

    A slash applies only to the next factor. Raises KeyError or IndexError if the tokens are not a unit.
    """
    scale, powers = 1.0, dict[str, int]()
    while tokens and tokens[0]["sign"] != ")":
        sign = -1 if tokens[0]["sign"] == "/" else 1
        if sign < 0:
            tokens = tokens[1:]
        if tokens[0]["sign"] == "(":
            factor, tokens = _product(tokens[1:])
            if tokens[0]["sign"] != ")":
                raise IndexError
        else:
            factor = Unit(*BASES[tokens[0]["name"]])
        tokens = tokens[1:]
        if tokens and tokens[0]["power"]:
            sign *= int(tokens[0]["power"].lstrip("^"))
            tokens = tokens[1:]
        scale *= factor.scale**sign
        for base, power in factor.powers.items():
            powers[base] = powers.get(base, 0) + sign * power
    return Unit(scale, {base: power for base, power in powers.items() if power}), tokens


def length_nm(text: str) -> float | None:
    """Convert a unit of length to nm, or return None for any other text. "A" is the ångström."""
    unit = parse("angstrom" if text in ("A", "AA", "Angstrom", "Angstroms", "ANGSTROM") else text)
    return unit.scale * 1e9 if unit is not None and unit.powers == {"m": 1} else None


def split(heading: str) -> tuple[str, str | None]:
    """Split a column heading such as "name (unit)", "name [unit]", "name / unit" or "name %" into name and unit.

    If there is no unit, the name is the whole heading, and the unit is None. A unit of raw readings may follow without
    brackets, as in "scope counts". It then remains part of the name.
    """
    heading = heading.strip()
    name, slash, rest = heading.partition(" / ")
    if slash and parse(rest):
        return name.strip(), rest.strip()
    if heading.endswith(" %"):
        return heading[:-2].strip(), "%"
    if heading[-1:] not in (")", "]"):
        raw = RAW_LAST.search(heading)
        return heading, raw[1] if raw else None
    opening, closing = ("(", ")") if heading[-1] == ")" else ("[", "]")
    depth, at = 0, len(heading)
    while at > 0:
        at -= 1
        depth += (heading[at] == closing) - (heading[at] == opening)
        if depth == 0:
            break
    inside = heading[at + 1 : -1].strip()
    if inside and (
        inside in RELATIVE_UNITS or parse(inside) or RAW.fullmatch(inside) or re.search(r"/|\bper\b|\^|⁻", inside)
    ):
        return heading[:at].strip(), inside
    return heading, None
