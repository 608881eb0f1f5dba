"""What can go wrong, and the exit code each kind of failure gives (README, "Exit codes")."""


class L3Error(Exception):
    """Something failed. The message is one line that names the culprit and the cure."""

    exit_code = 1


class RecipeError(L3Error):
    """A recipe or an option asks for something that cannot be."""

    exit_code = 2


class InputFileError(L3Error):
    """An input file is missing, broken, of the wrong kind, or does not fit the others."""

    exit_code = 3


class DeviceError(L3Error):
    """No usable OpenCL device."""

    exit_code = 4
