"""Atomic writes: a file is written under a temporary name and then renamed."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from slammot_graph.core.errors import InputError


def temporary_path(path: Path) -> Path:
    """Give the name under which a file is written before it is complete."""
    return path.with_name(f".{path.name}.tmp")


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Give a temporary path that replaces `path` on success and is removed on failure."""
    temporary = temporary_path(path)
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def write_errors(path: Path, remedy: str) -> Iterator[None]:
    """Turn an `OSError` into an `InputError` that names the path and the remedy."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error}); {remedy}") from error


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path for a file of a run folder, as `atomic_path` does.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    with write_errors(path, "free some space or name another --output"), atomic_path(path) as temporary:
        yield temporary


def write_text(path: Path, lines: Iterable[str]) -> None:
    """Write lines of UTF-8 text atomically."""
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(f"{line}\n" for line in lines)


def write_arrays(path: Path, **arrays: npt.NDArray[Any]) -> None:
    """Write a compressed ``.npz`` file atomically."""
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
