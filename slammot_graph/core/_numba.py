"""How this package compiles a kernel: cached on disk, without the GIL, and typed."""

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])

_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}


def kernel(function: F) -> F:
    """Compile `function` with numba at its first call and keep the machine code on disk.

    The code lies beside the source, or in the user's cache folder where that cannot be written, or in
    ``$NUMBA_CACHE_DIR``; where there is no place at all it is compiled by each process anew.

    The plain Python function stays reachable as ``.py_func``, which the tests use as an oracle.
    """
    try:
        return cast(F, numba.njit(cache=True, **_OPTIONS)(function))
    except RuntimeError:  # numba found no folder that it may write to
        return cast(F, numba.njit(**_OPTIONS)(function))


def is_compiled(kernel: Callable[..., object]) -> bool:
    """Tell whether machine code of a kernel, newer than its source, lies on disk."""
    cache = getattr(kernel, "_cache", None)
    folder = getattr(cache, "cache_path", None)
    function = getattr(kernel, "py_func", None)
    if folder is None or function is None:
        return False
    source = Path(inspect.getfile(function))
    changed = source.stat().st_mtime if source.exists() else 0.0
    indices = Path(folder).glob(f"{source.stem}.{function.__qualname__}-*.nbi")
    return any(index.stat().st_mtime >= changed for index in indices)
