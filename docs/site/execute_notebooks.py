"""Run the notebooks of docs/ and write each as a page NAME.md into a new folder.

    python docs/site/execute_notebooks.py FOLDER

With --strip instead of FOLDER, remove the outputs that Jupyter has stored in docs/notebooks.
"""

import base64
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import nbformat

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"
LONGEST = 300  # s; time limit of a cell
JOBS = 2  # notebooks that run at the same time; each has a kernel process
COLOURS = re.compile(r"\x1b\[[\d;]*m")  # escape sequences in a traceback
METADATA = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}


def stripped(notebook: Any) -> Any:
    """Return a notebook without outputs, execution counts, and metadata about the computer and the editor."""
    notebook = nbformat.from_dict(notebook)
    notebook.metadata = nbformat.from_dict(METADATA)
    for cell in notebook.cells:
        cell.metadata = nbformat.from_dict({})
        if cell.cell_type == "code":
            cell.outputs, cell.execution_count = [], None
    return notebook


def executed(path: Path) -> Any:
    """Run a notebook in a temporary folder, and return the notebook with its outputs.

    Raises CellExecutionError (a cell fails), CellTimeoutError (a cell takes too long) or DeadKernelError of nbclient.
    """
    from jupyter_client.manager import AsyncKernelManager
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory(prefix="l3-") as folder:
        kernels = AsyncKernelManager(transport="ipc")  # sockets in a private folder, so that no other user can connect
        kernels.connection_file = str(Path(folder, "kernel.json"))
        client = NotebookClient(notebook, km=kernels, timeout=LONGEST, resources={"metadata": {"path": folder}})
        client.execute(cleanup_kc=True, env=os.environ | {"TMPDIR": folder})
    return notebook


def page(notebook: Any, name: str, folder: Path) -> str:
    """Return a notebook as Markdown, and write its pictures into `folder`."""
    parts = []
    for number, cell in enumerate(notebook.cells):
        if cell.cell_type == "markdown":
            parts.append(cell.source)
        else:
            parts.append(f"```python\n{cell.source}\n```")
            parts += shown(cell.outputs, f"{name}-{number}", folder)
    parts.append(f"[The notebook]({name}.ipynb), without outputs.")
    return "\n\n".join(parts) + "\n"


def shown(outputs: Any, name: str, folder: Path) -> Iterator[str]:
    """Yield the outputs of a cell as Markdown: the printed text, the result, and the pictures."""
    printed = "".join(output.get("text", "") for output in outputs)
    if printed:
        yield f"```none\n{printed.rstrip()}\n```"
    for number, output in enumerate(outputs):
        data = output.get("data", {})
        if "image/png" in data:
            picture = f"{name}-{number}.png"
            (folder / picture).write_bytes(base64.b64decode(data["image/png"]))
            yield f"![What the cell above draws]({picture})"
        elif "text/plain" in data:
            yield f"```none\n{data['text/plain']}\n```"


def written(path: Path, folder: Path) -> str:
    """Run a notebook and write its page. Return a line with the time, or with the failed cell and its error."""
    from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError

    start = time.perf_counter()
    try:
        notebook = executed(path)
    except (CellExecutionError, CellTimeoutError, DeadKernelError) as error:
        return f"{path}: fails\n{COLOURS.sub('', str(error))}"
    shutil.copy(path, folder)
    (folder / f"{path.stem}.md").write_text(page(notebook, path.stem, folder), encoding="utf-8")
    return f"{path}: {time.perf_counter() - start:.1f} s"


def main(argument: str) -> int:
    """Return 0, 1 if a notebook fails, or 2 if the folder exists."""
    paths = sorted(NOTEBOOKS.glob("*.ipynb"))
    if argument == "--strip":
        for path in paths:
            nbformat.write(stripped(nbformat.read(path, as_version=4)), path)
        return 0
    folder = Path(argument)
    if folder.exists():
        print(f"{folder} exists; give a new folder", file=sys.stderr)
        return 2
    folder.mkdir(parents=True)
    with ThreadPoolExecutor(JOBS) as pool:
        for line in pool.map(lambda path: written(path, folder), paths):
            print(line, flush=True)
    return 0 if {path.stem for path in paths} == {path.stem for path in folder.glob("*.md")} else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
