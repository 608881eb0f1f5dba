"""Demosaicking methods as peers of a table: what each is called, whose it is, with which settings it may be run."""

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
    """The true noise of a mosaic where a white is 1: its shot noise, and its variance where there is no light."""

    electron: Array  # (channel) a photo-electron in the mosaic's unit
    dark: float  # electrons²


@dataclass(frozen=True)
class Denoiser:
    """A demosaicking that is given the noise of the mosaic, too."""

    channels: Callable[[Array, CFA, Noise], Array]

    def given(self, noise: Noise) -> Demosaic:
        return lambda mosaic, cfa: self.channels(mosaic, cfa, noise)


Method = Demosaic | Denoiser


class NotInstalled(Exception):
    """A program of rivals that this machine lacks; its text names it."""


@dataclass(frozen=True)
class Rival:
    """A method and the settings under which it runs, each a demosaicking; where several, the best counts."""

    name: str
    program: str  # with its version
    settings: Mapping[str, Method]

    @property
    def given_noise(self) -> bool:
        return any(isinstance(each, Denoiser) for each in self.settings.values())


def installed(package: str) -> str:
    """Name and version of a package; NotInstalled without it."""
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError as error:
        raise NotInstalled(package) from error


def gathered(programs: list[Callable[[], list[Rival]]]) -> tuple[list[Rival], list[str]]:
    """The rivals of every program that is installed, and the names of those that are not."""
    rivals: list[Rival] = []
    missing = []
    for program in programs:
        try:
            rivals += program()
        except NotInstalled as error:
            missing.append(str(error))
    return rivals, missing
