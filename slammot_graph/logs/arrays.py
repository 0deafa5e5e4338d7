"""Logs as arrays in an ``.npz`` file: read, and written by the simulator."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from slammot_graph.core.errors import ConfigError, InputError
from slammot_graph.core.files import check_npz
from slammot_graph.core.scan import LaserModel, ScanTruth
from slammot_graph.core.types import FloatArray
from slammot_graph.logs.base import RawScan, RecordedLog, Records, one_line
from slammot_graph.logs.mounting import laser_pose_source
from slammot_graph.logs.scan_odometry import odometry_of_log
from slammot_graph.logs.scan_stamps import mended
from slammot_graph.logs.source import SkippedScan
from slammot_graph.logs.sweep_times import sweep_times

SCALARS = ("angle_min", "angle_increment", "range_min", "range_max")
REQUIRED = ("stamps", "ranges", *SCALARS, "laser_pose")
OPTIONAL = ("odometry", "time_increment", "laser", "laser_poses")
TRUTH = ("poses", "is_moving", "object_id", "objects")
ESTIMATES = "poses_are_estimates"


class ArrayLog(RecordedLog):
    """A log kept in an ``.npz`` file, n scans of equal geometry; the keys are those of `write_npz_log`.

    Other keys are ignored. The arrays are held in memory.

    Parameters
    ----------
    path : Path
    laser_pose : (x, y, theta), optional
        The laser in the base [m, m, rad], in place of the key `laser_pose`; of several lasers, of the first.
    odometry : bool
        False: leave the key `odometry` aside.

    Raises
    ------
    InputError
        It is not an ``.npz`` file, a key is missing, or an array has the wrong shape or kind.
    """

    def __init__(
        self, path: Path, *, laser_pose: tuple[float, float, float] | None = None, odometry: bool = True
    ) -> None:
        self._arrays = _checked(path, _load(path))
        if laser_pose is not None:
            self._arrays["laser_pose"] = np.array(laser_pose)
        self._lasers = _lasers(path, self._arrays, is_first_given=laser_pose is not None)
        self._laser = self._lasers[0]
        told_by = "the key laser_pose" if laser_pose is None else "given"
        source = laser_pose_source(self._laser.T_base_laser, told_by)
        self._laser_of = self._arrays.get("laser", np.zeros(len(self._arrays["stamps"]), dtype=np.int64))
        if len(self._lasers) > 1:
            source["lasers"] = [
                {"laser_pose": x.T_base_laser, "n_scans": int(np.count_nonzero(self._laser_of == x.number))}
                for x in self._lasers
            ]
        if self._arrays.get(ESTIMATES, False):
            source["poses"] = "estimates"
        times = mended(self._arrays["stamps"])
        self._stamps = times.stamps
        told = self._arrays.get("odometry") if odometry else None
        self._odometry = odometry_of_log(told, self._stamps, is_wanted=odometry)
        source.update(self._odometry.source)
        sweep = sweep_times(
            float(self._arrays.get("time_increment", 0.0)),
            self._stamps[self._laser_of == 0],
            self._lasers[0],
            "the key time_increment",
        )
        self._beam_times = sweep.beam_times
        super().__init__(
            path,
            n_scans=len(self._stamps),
            opening_warnings=(*times.warnings, *self._odometry.warnings, *sweep.warnings),
            source=source,
        )

    def _records(self) -> Records:
        arrays, told, odometry = self._arrays, self._odometry, self._arrays.get("odometry")
        truth_keys = [key for key in TRUTH if key in arrays]
        for row in range(self.n_scans):
            truth = {key: arrays[key][row] for key in truth_keys}
            place = f"row {row}"
            try:
                T_odom_base = None if odometry is None else told.of(row, odometry[row])
            except ValueError as err:
                yield SkippedScan(place=place, reason=one_line(err))
                continue
            yield RawScan(
                place=place,
                stamp=float(self._stamps[row]),
                ranges=arrays["ranges"][row],
                laser=self._lasers[self._laser_of[row]],
                T_odom_base=T_odom_base,
                truth=_scan_truth(truth) if truth else None,
                odometry=told.track,
                beam_times=self._beam_times,
            )


def write_npz_log(
    path: str | Path,
    *,
    stamps: npt.ArrayLike,
    ranges: npt.ArrayLike,
    angle_min: float,
    angle_increment: float,
    range_min: float,
    range_max: float,
    odometry: npt.ArrayLike | None = None,
    time_increment: float | None = None,
    laser_pose: npt.ArrayLike = (0.0, 0.0, 0.0),
    poses: npt.ArrayLike | None = None,
    is_moving: npt.ArrayLike | None = None,
    object_id: npt.ArrayLike | None = None,
    objects: npt.ArrayLike | None = None,
    poses_are_estimates: bool = False,
    laser: npt.ArrayLike | None = None,
    laser_poses: npt.ArrayLike | None = None,
) -> None:
    """Write a log that `open_log` reads back; an existing file is replaced.

    Parameters
    ----------
    path : str or Path
        The file, whose name should end in ``.npz``.
    stamps : (n,) array [s]
    ranges : (n, beams) array [m]
    angle_min, angle_increment : float
        Direction of beam 0 and the step to the next [rad], laser frame, counter-clockwise.
    range_min, range_max : float
        Limits of a valid return [m].
    odometry : (n, 3) array, optional
        Base in odom: x [m], y [m], theta [rad].
    time_increment : float, optional
        Time between beams [s], of a laser that sweeps; the stamps are then those of the first beams.
    laser_pose : (3,) array
        Laser in base.
    poses : (n, 3) array, optional
        True base in world.
    is_moving : (n, beams) bool array, optional
        The beam hit something that moves.
    object_id : (n, beams) int array, optional
        Which object the beam hit; -1 for none.
    objects : (n, k, 4) array, optional
        True states of the objects: x, y [m], vx, vy [m/s] in the world; NaN while away.
    poses_are_estimates : bool
        The `poses` are those of a run, as in an injected log: not a truth to evaluate another run against.
    laser : (n,) int array, optional
        Which of several lasers of equal geometry took each scan, from 0.
    laser_poses : (k, 3) array, optional
        Each of these in the base; needed with `laser`.

    Raises
    ------
    InputError
        An array has the wrong shape or kind, or the file cannot be written.
    """
    path = Path(path)
    given: dict[str, npt.ArrayLike | None] = {
        "stamps": stamps,
        "ranges": ranges,
        "angle_min": angle_min,
        "angle_increment": angle_increment,
        "range_min": range_min,
        "range_max": range_max,
        "odometry": odometry,
        "time_increment": time_increment,
        "laser_pose": laser_pose,
        "poses": poses,
        "is_moving": is_moving,
        "object_id": object_id,
        "objects": objects,
        "laser": laser,
        "laser_poses": laser_poses,
        ESTIMATES: True if poses_are_estimates else None,
    }
    arrays = _checked(path, {key: np.asarray(value) for key, value in given.items() if value is not None})
    _lasers(path, arrays)
    try:
        with path.open("wb") as file:
            members: dict[str, Any] = {**arrays}
            np.savez_compressed(file, **members)
    except OSError as err:
        raise InputError(f"{path}: cannot be written ({one_line(err)}); choose another place") from None


def _load(path: Path) -> dict[str, npt.NDArray[Any]]:
    """The known arrays of a file."""
    check_npz(path)
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            return {
                key: _member(path, file, key)
                for key in (*REQUIRED, *OPTIONAL, *TRUTH, ESTIMATES)
                if key in file.files
            }
    except InputError:
        raise
    except Exception as err:  # the decoders of a damaged file may raise anything
        raise InputError(f"{path}: cannot be read as .npz ({one_line(err)}); write it again") from None


def _member(path: Path, file: "np.lib.npyio.NpzFile", key: str) -> npt.NDArray[Any]:
    try:
        array: npt.NDArray[Any] = file[key]
    except Exception as err:  # as above, and object arrays are refused
        raise InputError(
            f"{path}: `{key}` cannot be read ({one_line(err)}); write it as a plain array of numbers"
        ) from None
    return array


def _checked(path: Path, arrays: Mapping[str, npt.NDArray[Any]]) -> dict[str, npt.NDArray[Any]]:
    """The arrays, converted to their kinds and checked for their shapes."""
    missing = [key for key in REQUIRED if key not in arrays]
    if missing:
        raise InputError(f"{path}: lacks {', '.join(missing)}; a log needs the keys {', '.join(REQUIRED)}")
    converted = {key: _converted(path, key, array) for key, array in arrays.items()}
    if converted["ranges"].ndim != 2:
        raise InputError(
            f"{path}: `ranges` has shape {converted['ranges'].shape}; it needs a row a scan, a column a beam"
        )
    n_scans, n_beams = converted["ranges"].shape
    if n_scans == 0:
        raise InputError(f"{path}: holds no scans; `ranges` needs one row a scan")
    shapes = {
        "stamps": (n_scans,),
        "odometry": (n_scans, 3),
        "laser_pose": (3,),
        "poses": (n_scans, 3),
        "is_moving": (n_scans, n_beams),
        "object_id": (n_scans, n_beams),
        "objects": (n_scans, *converted.get("objects", np.empty(0)).shape[1:2], 4),
        "laser": (n_scans,),
        "laser_poses": (converted["laser_poses"].size // 3, 3) if "laser_poses" in converted else (0, 3),
        **dict.fromkeys((*SCALARS, "time_increment", ESTIMATES), ()),
    }
    for key, shape in shapes.items():
        if key in converted and converted[key].shape != shape:
            raise InputError(
                f"{path}: `{key}` has shape {converted[key].shape} where {shape} is needed for"
                f" `ranges` of shape {(n_scans, n_beams)}"
            )
    return converted


def _converted(path: Path, key: str, array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """An array as bool, int or float, as its key asks for; a scalar in brackets loses them."""
    if array.dtype.kind not in "biuf":
        raise InputError(f"{path}: `{key}` is of type {array.dtype}; write it as an array of numbers")
    if key in (*SCALARS, "time_increment") and array.size == 1:
        array = array.reshape(())
    kinds: dict[str, type] = {
        "is_moving": np.bool_,
        "object_id": np.int64,
        "laser": np.int64,
        ESTIMATES: np.bool_,
    }
    return np.asarray(array, dtype=kinds.get(key, np.float64), order="C")


def _lasers(
    path: Path, arrays: Mapping[str, npt.NDArray[Any]], *, is_first_given: bool = False
) -> list[LaserModel]:
    """The lasers of a log, in the order of their numbers."""
    first = _laser(path, arrays)
    if ("laser" in arrays) != ("laser_poses" in arrays):
        raise InputError(f"{path}: several lasers need both `laser` and `laser_poses`")
    if "laser" not in arrays:
        return [first]
    poses = arrays["laser_poses"]
    if not np.isfinite(poses).all() or not len(poses):
        raise InputError(
            f"{path}: `laser_poses` is empty or not finite; give x, y, theta of each laser in the base"
        )
    if arrays["laser"].min() < 0 or arrays["laser"].max() >= len(poses):
        raise InputError(f"{path}: `laser` counts from 0 to {len(poses) - 1}, the rows of `laser_poses`")
    lasers = [
        replace(first, T_base_laser=(pose[0], pose[1], pose[2]), number=number)
        for number, pose in enumerate(poses.tolist())
    ]
    return [first, *lasers[1:]] if is_first_given else lasers


def _laser(path: Path, arrays: Mapping[str, npt.NDArray[Any]]) -> LaserModel:
    laser_pose: FloatArray = arrays["laser_pose"]
    if not np.isfinite(laser_pose).all():
        raise InputError(f"{path}: `laser_pose` is not finite; give x, y, theta of the laser in the base")
    x, y, theta = laser_pose.tolist()
    try:
        return LaserModel(
            angle_min=float(arrays["angle_min"]),
            angle_increment=float(arrays["angle_increment"]),
            range_min=float(arrays["range_min"]),
            range_max=float(arrays["range_max"]),
            n_beams=arrays["ranges"].shape[1],
            T_base_laser=(x, y, theta),
        )
    except ConfigError as err:
        raise InputError(f"{path}: {err}; correct {', '.join(SCALARS)}") from None


def _scan_truth(row: Mapping[str, npt.NDArray[Any]]) -> ScanTruth:
    return ScanTruth(
        T_world_base=row.get("poses"),
        is_moving=row.get("is_moving"),
        object_id=row.get("object_id"),
        objects=row.get("objects"),
    )
