"""An environment in which make, Slurm job arrays and Snakemake run the real `l3`, but without its start-up time.

`l3` is a small client. It sends its arguments to this process, which runs the calls one after the other. `sbatch` is a
replacement that runs all tasks of a job immediately.
"""

import contextlib
import io
import os
import shlex
import subprocess
import sys
import tempfile
import threading
import traceback
from collections.abc import Iterator
from multiprocessing.connection import Client, Listener
from pathlib import Path

from l3cli.cli import run

PATH = f"{Path(sys.executable).parent}:{os.environ['PATH']}"  # programs of the test environment first
CLIENT = """#!{python} -IS
import os, sys
from multiprocessing.connection import Client
with Client({address!r}) as server:
    server.send((os.getcwd(), sys.argv[1:]))
    code, out, err = server.recv()
sys.stdout.write(out)
sys.stderr.write(err)
sys.exit(code)
"""
SBATCH = """#!{python} -IS
import argparse, os, pathlib, subprocess
parser = argparse.ArgumentParser()
for name in ("job-name", "output", "array", "dependency", "kill-on-invalid-dep"):
    parser.add_argument("--" + name)
parser.add_argument("--parsable", action="store_true", required=True)
parser.add_argument("script", type=pathlib.Path)
parser.add_argument("arguments", nargs=argparse.REMAINDER)
asked = parser.parse_args()
jobs = pathlib.Path({jobs!r})
job = str(101 + len(list(jobs.iterdir())))
kind, _, before = (asked.dependency or "").partition(":")
assert kind in ("", "afterok"), kind
state = (jobs / before / "state").read_text() if before else "done"
(jobs / job).mkdir()
script = jobs / job / "slurm_script"
script.write_bytes(asked.script.read_bytes())  # Slurm runs a copy from its spool
script.chmod(0o755)
first, _, last = (asked.array or "0").partition("-")
for task in range(int(first), int(last or first) + 1) if state == "done" else ():
    variables = dict(SLURM_JOB_ID=job, SLURM_CPUS_PER_TASK="1")
    variables |= dict(SLURM_ARRAY_TASK_ID=str(task)) if asked.array else dict()
    log = asked.output.replace("%x", asked.job_name).replace("%A", job).replace("%a", str(task))
    with open(log, "w") as written:
        done = subprocess.run([script, *asked.arguments], env=os.environ | variables, stdout=written, stderr=written)
    state = state if done.returncode == 0 else "failed"
(jobs / job / "state").write_text(state)
print(job)
"""


class Workplace:
    """A PATH whose `l3` and `sbatch` run in this process, and a record of the calls of `l3`."""

    def __init__(self, folder: Path, address: str) -> None:
        self.calls: list[str] = []  # command and output file of each call except `l3 check`, in order
        self.bin = folder
        (folder / "jobs").mkdir()
        for name, text in {"l3": CLIENT, "sbatch": SBATCH}.items():
            (folder / name).write_text(text.format(python=sys.executable, address=address, jobs=str(folder / "jobs")))
            (folder / name).chmod(0o755)

    def serve(self, listener: Listener) -> None:
        """Answer calls until a call has no arguments."""
        while True:
            with listener.accept() as caller:
                folder, arguments = caller.recv()
                if not arguments:
                    return
                out, err = io.StringIO(), io.StringIO()
                with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                    try:
                        code = run(arguments)
                    except Exception:
                        traceback.print_exc()
                        code = 1
                if arguments[0] == "check":  # pipelines use it to list the files that a camera recipe names
                    caller.send((code, out.getvalue(), err.getvalue()))
                    continue
                self.calls.append(
                    f"{arguments[0]} {arguments[arguments.index('-o') + 1] if '-o' in arguments else ''}".strip()
                )
                caller.send((code, out.getvalue(), err.getvalue()))

    def start(self, folder: Path, command: str) -> subprocess.Popen:
        environment = os.environ | {"PATH": f"{self.bin}:{PATH}"}
        for inherited in ("MAKEFLAGS", "MAKELEVEL"):  # set if make runs the tests
            environment.pop(inherited, None)
        return subprocess.Popen(
            shlex.split(command), cwd=folder, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            start_new_session=True,
        )  # fmt: skip

    def do(self, folder: Path, command: str, code: int = 0) -> tuple[str, list[str]]:
        """Run a command that must exit with `code`. Returns its output and the calls of l3 that it made."""
        self.calls.clear()
        process = self.start(folder, command)
        out, err = process.communicate(timeout=600)
        assert process.returncode == code, out + err
        return out, list(self.calls)


@contextlib.contextmanager
def a_workplace(folder: Path) -> Iterator[Workplace]:
    """Set up a workplace whose programs are in `folder`, which must be empty."""
    with tempfile.TemporaryDirectory() as short:  # names of sockets must be short
        address = f"{short}/socket"
        place = Workplace(folder, address)
        with Listener(address) as listener:
            server = threading.Thread(target=place.serve, args=(listener,))
            server.start()
            try:
                yield place
            finally:
                with Client(address) as caller:
                    caller.send((None, None))
                server.join()
