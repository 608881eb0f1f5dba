"""Smoothing of a table's spectra after its last layer (docs/method.md#smoothed-spectra)."""

from dataclasses import dataclass

from l3cli.artifacts.schema import check, data

WINDOWS = (3, 5, 7, 9)  # sides that can be


@dataclass(frozen=True)
class SpectralSmoothing:
    """Every pixel takes the mean spectrum of the pixels of like brightness about it, and keeps its own brightness."""

    window: int = data("int64", unit="pixel", doc="side of the neighbourhood of a pixel")
    reach: float = data(
        "float64", doc="difference of brightness, a share of the pixel's own, from which others do not count"
    )

    def __post_init__(self) -> None:
        check(self)
        if self.window not in WINDOWS:
            raise ValueError(f"window is {self.window}, not one of {', '.join(map(str, WINDOWS))}")
        if not 0 < self.reach < 1:
            raise ValueError(f"reach is {self.reach:g}, not between 0 and 1")

    @property
    def radius(self) -> int:
        return self.window // 2
