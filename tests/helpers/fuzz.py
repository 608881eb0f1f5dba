"""Runs l3 on many hostile inputs, in processes whose crashes are noticed: `python -m tests.helpers.fuzz`.

A failing input is kept. Choices come from seeds, so `--first SEED --inputs 1 --batch` repeats one input.
"""

import argparse
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

BATCH = 1000  # inputs per process
IDENTITIES = "identities"  # --only identities: only outputs that are also inputs
PHYSICS = 100  # one of 100 seeds makes a physical mistake in a lab instead of corrupting a file
FORKS = 50  # one of 50 seeds forks a process that uses l3
NAMES = 100  # one of 100 seeds gives a file in a pipeline of l3 init a hostile name
SLOW = 3  # seconds of processor time; slower inputs are reported


class Seeded:
    """Random choices from a seed."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)

    def integer(self, least: int, most: int) -> int:
        return self._random.randint(least, most)


class Court:
    """Runs inputs and keeps those that fail."""

    def __init__(self, shop: Any, seen: list[str], left: Path, only: str | None) -> None:
        from tests.helpers.hostile import SUBJECTS
        from tests.helpers.hostile_dng import DngTags
        from tests.helpers.hostile_identities import Identities

        self._identities = Identities(shop)
        every: tuple[Any, ...] = (*SUBJECTS, DngTags())
        chosen = [subject for subject in every if only is None or subject.name == only]
        self.subjects = [subject for turn in range(3) for subject in chosen if only or subject.often > turn]
        self._shop, self._seen, self._saved = shop, seen, left

    def judge(self, number: int, subject: Any, choices: Any) -> str | None:
        """Corrupt the subject's file and read it, or make a call drawn by the subject. Return what went wrong, or None."""
        if hasattr(subject, "draw"):
            call, command = subject.draw(choices), 0
            content, stored = str(call).encode(), lambda: subject.judge(self._shop, call)
        else:
            content = subject.spoil(self._shop.whole[subject.name], choices)
            command = choices.integer(0, len(subject.commands) - 1)
            stored = lambda: self._shop.judge_content(subject, content, command)  # noqa: E731
        mark = self._saved / f"{number}_{command}_{subject.name.replace('/', '_')}"
        mark.write_bytes(content)  # before the file is read, because reading may crash this process
        start = time.process_time()
        verdict = stored() or (self._seen.pop() if self._seen else None)
        if (took := time.process_time() - start) > SLOW:
            print(f"{mark.name}: slow, {took:.1f} s", flush=True)
        if verdict is None:
            mark.unlink()
        else:
            mark.with_suffix(mark.suffix + ".txt").write_text(verdict)
            print(f"{mark.name}: {verdict.strip().splitlines()[-1]}", flush=True)
        return verdict

    def judge_identities(self, number: int, choices: Any) -> str | None:
        """Let a command write over one of its inputs, and return what went wrong, or None."""
        verdict = self._identities.judge(choices) or (self._seen.pop() if self._seen else None)
        if verdict is not None:
            mark = self._saved / f"{number}_{IDENTITIES}.txt"
            mark.write_text(verdict)
            print(f"{mark.name}: {verdict.strip().splitlines()[-1]}", flush=True)
        return verdict


@contextmanager
def court(left: Path, only: str | None) -> Iterator[Court]:
    from tests.helpers.hostile import Workshop, confined, watched

    with tempfile.TemporaryDirectory(prefix="l3-fuzz-") as name:
        shop = Workshop(Path(name))
        with confined(), watched(Path(tempfile.gettempdir()), left.absolute()) as seen:
            yield Court(shop, seen, left, only)


def batch(chosen: argparse.Namespace) -> int:
    """Run the inputs of some seeds with all subjects in turn. Return the number of failures."""
    seeds = range(chosen.first, chosen.first + chosen.inputs)
    failed = 0 if chosen.only else physics([seed for seed in seeds if seed % PHYSICS == 0])
    failed += 0 if chosen.only else forks([seed for seed in seeds if seed % FORKS == 0])
    if chosen.only in (None, "names"):
        failed += names([seed for seed in seeds if chosen.only or seed % NAMES == 0])
    if chosen.only == "names":
        return failed
    with court(chosen.kept, chosen.only) as judges:
        for seed in seeds:
            if chosen.only == IDENTITIES or (chosen.only is None and seed % 10 == 0):
                failed += judges.judge_identities(seed, Seeded(seed)) is not None
            if chosen.only == IDENTITIES:
                continue
            subject = judges.subjects[seed % len(judges.subjects)]
            failed += judges.judge(seed, subject, Seeded(seed)) is not None
    return failed


def physics(seeds: list[int]) -> int:
    """Run a lab with one physical mistake per seed. Return how many gave a wrong camera or an unclear error."""
    from tests.helpers.hostile_physics import judge_seeds

    failed = 0
    for seed, verdict in judge_seeds(seeds):
        failed += 1
        print(f"physics {seed}: {verdict.strip()}", flush=True)
    return failed


def forks(seeds: list[int]) -> int:
    """Run a forked child per seed. Return how many hung or differed from their parent."""
    from tests.helpers.hostile_forks import drawn, judge_cases

    failed = 0
    for verdict in judge_cases(drawn(Seeded(seed)) for seed in seeds):
        failed += 1
        print(f"forks: {verdict.strip()}", flush=True)
    return failed


def names(seeds: list[int]) -> int:
    """Run a pipeline with a hostile name per seed. Return how many executed the name or lost it."""
    from tests.helpers.hostile_names import Pipelines

    failed = 0
    with tempfile.TemporaryDirectory(prefix="l3-names-") as name:
        pipelines = Pipelines(Path(name))
        for seed in seeds:
            if (verdict := pipelines.judge(Seeded(seed))) is not None:
                failed += 1
                print(f"names {seed}: {verdict.strip()}", flush=True)
    return failed


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--inputs", type=int, default=20_000)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", help="one subject, such as camera.h5")
    parser.add_argument("--kept", type=Path, default=Path("build/fuzz"), help="folder for inputs that failed")
    parser.add_argument("--batch", action="store_true", help="judge in this process")
    chosen = parser.parse_args()
    chosen.kept.mkdir(parents=True, exist_ok=True)
    if chosen.batch:
        return min(batch(chosen), 100)
    command = [sys.executable, "-m", "tests.helpers.fuzz", "--batch", "--kept", str(chosen.kept)]
    command += ["--only", chosen.only] if chosen.only else []

    def one(first: int) -> int:
        count = min(BATCH, chosen.first + chosen.inputs - first)
        code = subprocess.run([*command, "--first", str(first), "--inputs", str(count)], check=False).returncode
        if code < 0:
            print(f"seeds {first}…{first + count - 1}: the process died of signal {-code}; its input lies in {chosen.kept}")
        print(f"seeds {first}…{first + count - 1}: {abs(code)} failures", flush=True)
        return abs(code)

    with ThreadPoolExecutor(chosen.jobs) as pool:
        failed = sum(pool.map(one, range(chosen.first, chosen.first + chosen.inputs, BATCH)))
    print(f"{chosen.inputs} inputs, {failed} failures" + (f"; {chosen.kept} holds them" if failed else ""))
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
