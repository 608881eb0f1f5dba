"""Which files the name or glob of a scene stands for."""

from pathlib import Path

from l3cli.errors import InputFileError

MOST_WILD = 4  # parts of a glob with a wildcard: each multiplies the folders that are searched


def find(pattern: str, folder: Path, folders: bool = False) -> list[Path]:
    """Return the files (or `folders`) of a name or glob relative to `folder`, sorted; InputFileError if there is none."""
    wanted = Path.is_dir if folders else Path.is_file
    single = folder / pattern
    if wanted(single):
        return [single]
    if single.is_dir():
        raise InputFileError(f"{single} is a folder; name the scene files in it")
    if sum(any(letter in part for letter in "*?[") for part in single.parts) > MOST_WILD:
        raise InputFileError(f"{single} has wildcards in more than {MOST_WILD} folders; name a folder nearer to the files")
    root = Path(single.anchor)  # "" for a relative folder
    try:
        paths = sorted(path for path in root.glob(str(single.relative_to(root))) if wanted(path))
    except ValueError as error:
        raise InputFileError(f'{single} is no glob; write "**" between slashes only') from error
    if not paths:
        raise InputFileError(f"{single} does not exist; name a scene file or a glob relative to the recipe")
    return paths
