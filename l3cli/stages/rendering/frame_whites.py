"""The white of frame after frame, and what is said of it."""

from l3cli.frames.frame import RawFrame
from l3cli.rendering.white.balance import SteadyWhite, WhiteBalance
from l3cli.rendering.white.scene_white import SceneWhite, implausible, unlike_stated
from l3cli.rendering.white.source import WhiteSource
from l3cli.stages.rendering.chart_white import ChartSceneWhite
from l3cli.system.console import Console


class FrameWhites:
    """Measures frames in their order. `steady`: the balance follows from frame to frame, or stays that of the first one if
    the source is held; without it each frame has its own."""

    def __init__(self, source: WhiteSource, steady: SteadyWhite | None) -> None:
        self._source, self._steady = source, steady
        self._first: SceneWhite | None = None
        self.balance: WhiteBalance | None = None  # of the last frame measured; None: there was nothing to tell it by

    def measured(self, frame: RawFrame) -> SceneWhite | None:
        """White of the next frame, None where there is nothing to tell it by; InputFileError if it cannot be taken."""
        if self._steady is None:
            white = self._source.white(frame)
            self.balance = white.balance if white else None
            return white
        if self._first is not None and self._source.held:
            return self._first
        white = self._source.white(frame)
        self._first = self._first or white
        self.balance = self._steady.balance(white.balance if white else None)
        return white


class WhiteReport:
    """Says which white was assumed: of every still, of the first frame of a sequence and, if it has moved, of the last."""

    def __init__(self, source: WhiteSource | None, stills: bool, console: Console) -> None:
        self._source, self._stills, self._console = source, stills, console
        self._last: tuple[str, SceneWhite] | None = None
        self._reported: SceneWhite | None = None
        self._warned = False

    def report_white(self, frame: RawFrame, white: SceneWhite | None) -> None:
        """Take note of a frame."""
        if self._source is None:
            return
        if white is None:
            if self._stills:
                self._console.info(f"{frame.name}: nothing to tell its white by; the table's is taken")
            return
        self._last = frame.name, white
        if self._stills or self._reported is None:
            self._report(frame.name, white)
        if not self._warned:
            self._warned = True
            doubts = [implausible(f"{frame.name}: its white, {self._source.about},", white)]
            if isinstance(white, ChartSceneWhite) and white.stated is not None:
                doubts.append(unlike_stated(frame.name, white, white.stated))
            for doubt in filter(None, doubts):
                self._console.warn(doubt)

    def report(self) -> None:
        """At the end."""
        if self._last and self._last[1] is not self._reported:
            self._report(*self._last)

    def _report(self, name: str, white: SceneWhite) -> None:
        assert self._source is not None
        self._reported = white
        self._console.info(f"{name}: white {self._source.about}: {white}")
