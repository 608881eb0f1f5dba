"""Division of a pass: frames into blocks, blocks and sites among processes. Sums are the same however it is done."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from l3cli.training.sums import empty_sums
from l3cli.training.training_pass import TrainingPass

BATCH = 50_000  # patches that are sorted together: bounds memory, and makes a class's product large enough to be fast
LAYER_ROWS = 300_000  # of a refinement layer that are sorted together
SUM_BYTES = 200 << 20  # of sums that a process fills at a time, if it is more than those of two sites


@dataclass(frozen=True)
class WorkShare:
    """Blocks and sites that one process sums up in one go over the frames."""

    blocks: tuple[tuple[range, tuple[int, ...]], ...]  # frames, and the canonical sites that take patches from them
    whole: tuple[int, ...]  # the sites that no other share takes part in

    @property
    def sites(self) -> tuple[int, ...]:
        return tuple(sorted({site for _, sites in self.blocks for site in sites}))


def frame_blocks(patches: Sequence[int], most: int | None = None) -> list[range]:
    """The frames, with so many `patches` (frame), in runs of about `most`, BATCH if not given, or less, which are sorted
    together; whole blocks are dealt to shards and processes. Blocks are nearly equal, so that nobody waits for the
    largest."""
    total, before = sum(patches), 0
    blocks = -(-total // (most or BATCH))
    starts: list[int] = []
    for index, count in enumerate(patches):
        if before * blocks // total >= len(starts):
            starts.append(index)
        before += count
    return [range(first, last) for first, last in itertools.pairwise([*starts, len(patches)])]


def work_shares(pass_: TrainingPass, divisors: Mapping[int, int], blocks: list[range], jobs: int) -> list[WorkShare]:
    """All blocks of all sites, whose patches are divided by `divisors`, in nearly equal shares for `jobs` processes, each
    of as few sites as can be."""
    one = empty_sums(pass_.rule, len(pass_.head.outputs))
    most = max(2, SUM_BYTES // one.moments.nbytes)  # sites at a time
    units = [(site, block) for site in divisors for block in blocks]
    work = np.cumsum([0.0, *(1 / divisors[site] for site, _ in units)])
    for count in itertools.count(jobs, jobs):
        edges = np.searchsorted(work, work[-1] * np.arange(count + 1) / count - 1e-9).tolist()
        parts = [units[first:last] for first, last in itertools.pairwise(edges) if last > first]
        if max((len({site for site, _ in part}) for part in parts), default=0) <= most:
            break
    return [
        WorkShare(
            tuple(
                (block, tuple(site for site, frames in part if frames == block))
                for block in blocks
                if block in {frames for _, frames in part}
            ),
            tuple(site for site in divisors if all((site, block) in part for block in blocks)),
        )
        for part in parts
    ]
