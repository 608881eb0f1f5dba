"""numpy's .npy files, mapped: a header may claim any size, the file must have it."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.files import require_regular


def map_array(path: Path) -> NDArray[Any]:
    """The array of a .npy file. InputFileError if the file is none, is cut, or holds objects, which would be unpickled."""
    require_regular(path, "give a .npy file")
    try:
        with np.errstate(over="ignore"):  # of a shape beyond all bounds, which is refused
            values = np.load(path, mmap_mode="r", allow_pickle=False)
    except OSError as error:
        raise InputFileError(f"{path}: {error.strerror or error}") from error
    except Exception as error:  # a damaged header makes Python's tokenizer fail with many exceptions
        raise InputFileError(f"{path} is not a whole .npy file; write it with numpy.save(file, array)") from error
    if not isinstance(values, np.ndarray):
        values.close()
        raise InputFileError(f"{path} is an archive; give one .npy array")
    return values
