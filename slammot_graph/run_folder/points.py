"""``points.npz``: the labels of all beams."""

from pathlib import Path

import numpy as np

from slammot_graph.core.errors import InputError
from slammot_graph.core.files import check_npz
from slammot_graph.core.results import RunResult
from slammot_graph.core.saved_run import PointLabels
from slammot_graph.run_folder.atomic import write_arrays

_KINDS = {"stamps": "f", "is_valid": "b", "is_moving": "b", "is_moving_online": "b", "p_moving": "f"}


def write_points(path: Path, result: RunResult) -> None:
    """Write the labels of a run's beams; of a run that started from a map, what has changed since too.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    changed = {}
    if result.is_changed is not None:
        changed = {
            "changed": result.is_changed,
            "new_points": result.new_points,
            "gone_points": result.gone_points,
        }
    write_arrays(
        path,
        stamps=result.stamps,
        is_valid=result.is_valid,
        is_moving=result.is_moving,
        is_moving_online=result.is_moving_online,
        p_moving=np.asarray(result.p_moving, dtype=np.float16),
        laser=np.zeros(len(result.stamps), dtype=np.int64) if result.laser is None else result.laser,
        **changed,
    )


def read_points(path: str | Path) -> PointLabels:
    """Read the labels of a run's beams.

    Raises
    ------
    InputError
        The file is missing or is not what a run writes; the text names the fault.
    """
    path = Path(path)
    check_npz(path)
    try:
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            missing = [name for name in _KINDS if name not in file]
            if missing:
                raise InputError(f"{path}: has no array {missing[0]!r}; is it the points.npz of a run?")
            arrays = {name: np.asarray(file[name]) for name in _KINDS}
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); check the path") from None
    except InputError:
        raise
    except Exception:  # the decoders of a damaged file may raise anything
        raise InputError(f"{path}: not a complete .npz file of plain arrays; run it again") from None
    shape = arrays["is_valid"].shape
    for name, array in arrays.items():
        expected = shape[:1] if name == "stamps" else shape
        if len(shape) != 2 or array.shape != expected or array.dtype.kind != _KINDS[name]:
            raise InputError(
                f"{path}: array {name!r} is {array.dtype} {array.shape}, which does not fit points of a run"
            )
    return PointLabels(
        stamps=arrays["stamps"].astype(np.float64),
        is_valid=arrays["is_valid"],
        is_moving=arrays["is_moving"],
        is_moving_online=arrays["is_moving_online"],
        p_moving=arrays["p_moving"].astype(np.float16),
    )
