"""One run at a time writes into a folder: a lock file that names its owner, and that ends with its process."""

import json
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from slammot_graph.core.errors import InputError
from slammot_graph.run_folder.atomic import write_errors

try:
    import fcntl
except ImportError:  # a system without such locks: nothing is refused there
    fcntl = None  # type: ignore[assignment]

LOCK_FILE = ".run.lock"
"""Its content is for people; what counts is the system's lock on it, which ends with the process, however that ends."""


@contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder that is there, and leave no lock file behind.

    Where the system or the file system knows no locks, nothing is held.

    Raises
    ------
    InputError
        Another run holds it, or the folder cannot be written.
    """
    path = folder / LOCK_FILE
    file = _locked(path)
    try:
        owner = {"process": os.getpid(), "host": socket.gethostname(), "since": time.time()}
        with write_errors(path, "free some space or name another --output"):
            file.truncate(0)
            file.write(json.dumps(owner).encode())
            file.flush()
        yield
    finally:
        with suppress(OSError):  # the folder may be gone
            path.unlink(missing_ok=True)
        with suppress(OSError):  # what a full disk did not take
            file.close()


def _locked(path: Path) -> BinaryIO:
    """Open and lock the file that has this name now: its last owner may just have removed it."""
    while True:
        with write_errors(path.parent, "name another --output"):
            file = path.open("a+b")
        if fcntl is None:
            return file
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = _owner(file)
            file.close()
            raise InputError(
                f"{path.parent}: another run writes into it ({owner}); wait for it, or name another --output"
            ) from None
        except OSError:  # a file system without locks
            return file
        with suppress(OSError):
            if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                return file
        file.close()


def _owner(file: BinaryIO) -> str:
    """Say who holds the lock, and for how long."""
    try:
        file.seek(0)
        owner = json.loads(file.read(1000))
        return f"process {owner['process']} on {owner['host']}, for {max(time.time() - owner['since'], 0.0):.0f} s"
    except (OSError, ValueError, KeyError, TypeError):
        return "its owner has not given its name yet"
