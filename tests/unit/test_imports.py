"""Ctrl-C while a module is imported comes when it is whole: half a module is taken for one that is not there."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.paths import CONFIGS

# A shell starts what runs in its background with SIGINT ignored, and children inherit that.
PROGRAM = """
import signal, sys, time
from l3cli.system.signals import Terminated, heed
signal.signal(signal.SIGINT, signal.default_int_handler)
heed()
try:
    try:
        import half
    except ImportError:
        print("lost")
    time.sleep(5)
    print("never came")
except (KeyboardInterrupt, Terminated) as ended:
    print(type(ended).__name__, sys.modules["half"].is_whole)
"""
# As compiled modules do: what is raised while they begin is a failure of theirs.
HALF = """
import os, signal
try:
    os.kill(os.getpid(), signal.{name})
    for _ in range(1000):
        pass
except BaseException as error:
    raise ImportError("cannot begin") from error
is_whole = True
"""


@pytest.mark.parametrize(("name", "ending"), [("SIGINT", "KeyboardInterrupt"), ("SIGTERM", "Terminated")])
def test_a_signal_waits_for_the_end_of_an_import(tmp_path: Path, name: str, ending: str) -> None:
    (tmp_path / "half.py").write_text(HALF.format(name=name))
    known = {"PYTHONPATH": f"{CONFIGS.parent}:{tmp_path}"}
    ended = subprocess.run([sys.executable, "-c", PROGRAM], env=known, capture_output=True, text=True, check=True)
    assert ended.stdout == f"{ending} True\n"
