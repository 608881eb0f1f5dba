"""python -m tests.fuzz: many hostile inputs, in processes whose crash is seen; every failure leaves its input behind."""

import argparse
import random
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.hostile import SUBJECTS, Workshop, confined, watched

BATCH = 500  # inputs a process


class Seeded:
    """Choices of a seed."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)

    def integer(self, least: int, most: int) -> int:
        return self._random.randint(least, most)


def batch(first: int, count: int, kept: Path, only: str | None) -> int:
    """Judge the inputs of seeds first … first + count − 1, one subject after the other; how many failed."""
    subjects = [subject for subject in SUBJECTS if only is None or subject.name == only]
    failed = 0
    with tempfile.TemporaryDirectory(prefix="l3-fuzz-") as name:
        shop = Workshop(Path(name))
        with confined(), watched(Path(name), Path(tempfile.gettempdir())) as seen:
            for seed in range(first, first + count):
                subject, choices = subjects[seed % len(subjects)], Seeded(seed)
                content = subject.spoil(shop.whole[subject.name], choices)
                command = choices.integer(0, len(subject.commands) - 1)
                mark = kept / f"{seed}_{command}_{subject.name.replace('/', '_')}"
                mark.write_bytes(content)
                start = time.monotonic()
                verdict = shop.judge_content(subject, content, command) or (seen.pop() if seen else None)
                if (took := time.monotonic() - start) > 5:
                    print(f"{mark.name}: slow, {took:.1f} s", flush=True)
                if verdict is None:
                    mark.unlink()
                    continue
                failed += 1
                mark.with_suffix(mark.suffix + ".txt").write_text(verdict)
                print(f"{mark.name}: {verdict.strip().splitlines()[-1]}", flush=True)
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
        return min(batch(chosen.first, chosen.inputs, chosen.kept, chosen.only), 100)
    command = [sys.executable, "-m", "tests.fuzz", "--batch", "--kept", str(chosen.kept)]
    command += ["--only", chosen.only] if chosen.only else []
    starts = range(chosen.first, chosen.first + chosen.inputs, BATCH)

    def one(first: int) -> int:
        count = min(BATCH, chosen.first + chosen.inputs - first)
        code = subprocess.run([*command, "--first", str(first), "--inputs", str(count)], check=False).returncode
        if code < 0:
            print(f"seeds {first}…{first + count - 1}: the process died of signal {-code}; its input lies in {chosen.kept}")
        return code

    with ThreadPoolExecutor(chosen.jobs) as pool:
        codes = list(pool.map(one, starts))
    print(f"{chosen.inputs} inputs, {sum(map(abs, codes))} failures; {chosen.kept} holds them")
    return int(any(codes))


if __name__ == "__main__":
    sys.exit(main())
