"""The one way in which this package compiles a kernel: cached on disk, without the GIL, and typed."""

from collections.abc import Callable
from typing import TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def kernel(function: F) -> F:
    """Compile `function` with numba at its first call and keep the machine code on disk.

    The plain Python function stays reachable as ``.py_func``, which the tests use as an oracle.
    """
    return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy")(function))
