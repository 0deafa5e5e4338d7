"""Colours of pictures, each as one number."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def as_numbers(rgb: NDArray[Any]) -> NDArray[np.int64]:
    """(...,) numbers of colours (..., 3) from 0 to 255: far faster compared and counted than rows are."""
    return np.asarray(rgb.astype(np.int64) @ (1, 256, 65536))
