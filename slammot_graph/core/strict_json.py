"""Values as JSON has them: numbers that it does not know become null."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np


def strict_json(value: Any) -> Any:
    """Turn what JSON does not know into what it does: undefined and infinite numbers become null."""
    if isinstance(value, Mapping):
        return {str(key): strict_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [strict_json(item) for item in value]
    if isinstance(value, np.generic):
        return strict_json(value.item())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value
