"""Files that commands write: whole or not there, and refused before anything is computed."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from slammot_graph.errors import InputError


def prepare_file(output: Path) -> None:
    """Find out that a file cannot be written before it is computed."""
    if output.exists() and not output.is_file():
        raise InputError(f"{output}: is no plain file; name another --output")
    output.parent.mkdir(parents=True, exist_ok=True)
    if not os.access(output.parent, os.W_OK | os.X_OK):
        raise InputError(f"{output}: cannot be written (Permission denied); name another --output")


@contextlib.contextmanager
def whole_file(output: Path) -> Iterator[Path]:
    """Give a temporary name that becomes `output` when all went well, and goes away when not."""
    unfinished = output.with_name(f".{output.name}.tmp")
    try:
        yield unfinished
        unfinished.replace(output)
    finally:
        unfinished.unlink(missing_ok=True)
