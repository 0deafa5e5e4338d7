"""Files that commands read and write; what cannot be written is refused before anything is computed."""

import os
from pathlib import Path

from slammot_graph.core.errors import InputError


def prepare_file(output: Path) -> None:
    """Check that a file can be written, before it is computed.

    Raises
    ------
    InputError
        It cannot.
    """
    if output.exists() and not output.is_file():
        raise InputError(f"{output}: is no plain file; name another --output")
    output.parent.mkdir(parents=True, exist_ok=True)
    if not os.access(output.parent, os.W_OK | os.X_OK):
        raise InputError(f"{output}: cannot be written (Permission denied); name another --output")
