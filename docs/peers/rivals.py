"""Data types for demosaicing methods with which tables are compared: name, program and settings."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
CFA = NDArray[np.uint8]
Demosaic = Callable[[Array, CFA], Array]  # mosaic (row, col) where a white is 1, CFA → channels (channel, row, col)
PLAIN = ""  # the setting that changes nothing


@dataclass(frozen=True)
class Noise:
    """The true noise of a mosaic in which a white is 1: its shot noise, and its variance in the dark."""

    electron: Array  # (channel) value of a photo-electron in the mosaic
    dark: float  # electrons²


@dataclass(frozen=True)
class Denoiser:
    """A demosaicing method that also uses the noise of the mosaic."""

    channels: Callable[[Array, CFA, Noise], Array]

    def given(self, noise: Noise) -> Demosaic:
        return lambda mosaic, cfa: self.channels(mosaic, cfa, noise)


Method = Demosaic | Denoiser


class NotInstalled(Exception):
    """A program is not installed. The message is the name of the program."""


@dataclass(frozen=True)
class Rival:
    """A method with one or more settings. The result of the method is the result with the best setting."""

    name: str
    program: str  # with its version
    settings: Mapping[str, Method]

    @property
    def given_noise(self) -> bool:
        return any(isinstance(each, Denoiser) for each in self.settings.values())


def installed(package: str) -> str:
    """Return the name and the version of a package. Raise NotInstalled if the package is missing."""
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError as error:
        raise NotInstalled(package) from error


def gathered(programs: list[Callable[[], list[Rival]]]) -> tuple[list[Rival], list[str]]:
    """Return the rivals of all installed programs, and the names of the missing programs."""
    rivals: list[Rival] = []
    missing = []
    for program in programs:
        try:
            rivals += program()
        except NotInstalled as error:
            missing.append(str(error))
    return rivals, missing
