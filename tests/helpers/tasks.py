"""Functions that tests run in worker processes. Workers import this module, so it imports little itself."""

from l3cli.errors import L3Error

PATIENCE = 300.0  # seconds that a busy machine may take


def squared(number: int) -> int:
    return number * number


def refusing(number: int) -> int:
    raise L3Error(f"not {number}")
