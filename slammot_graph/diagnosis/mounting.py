"""Where a laser sits that nothing tells of: its yaw, and whether it is upside down, by the drive (hand-eye).

The laser alone is localized over the first metres, as if it were the base. Its increments M and those of the
odometry, O, are tied by the mounting X = (p, psi): ``O X = X M``, so ``R(psi) t_M = t_O + (R(theta) - I) p``, linear
in cos psi, sin psi and p. A laser upside down sees the world mirrored: its turns are opposite to those of the odometry.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.log_info import SourceInfo
from slammot_graph.core.scan import LaserModel, Scan
from slammot_graph.core.types import FloatArray
from slammot_graph.logs import source_of
from slammot_graph.logs.remounted import RemountedLog, upside_down
from slammot_graph.logs.source import LaserLog, beginning_of
from slammot_graph.methods import get_method
from slammot_graph.pipeline import Pipeline
from slammot_graph.pipeline_config import PipelineConfig

MAX_SCANS, MAX_PATH_M, MAX_TURN_RAD = 600, 15.0, 9.0
"""The drive is looked at until one of these is reached: scans, path and turns of the odometry."""

STEP_M, STEP_RAD = 0.3, 0.3
"""Increments are joined until they are one of these long."""

MIN_STEPS = 6
MIN_TURN_RAD = 1.0
"""Less turning, one way and the other, does not tell whether the laser is upside down."""

MIN_CORRELATION = 0.8
"""Of the turns of laser and odometry."""

MIN_YAW_RAD, MAX_YAW_STD_RAD = math.radians(10.0), 0.1
"""A yaw below the first is left to the calibration of the odometry; one less certain than the second is none."""

OFFSET_STD_M = 0.5
"""Prior standard deviation of the laser's place on the base, per axis."""

NOT_TOLD = "the laser is taken to sit on the base"
"""Words of the log's warning that a mounting found takes the place of."""

Source = TypeVar("Source", bound=Iterable[Scan])


@dataclass(frozen=True, kw_only=True)
class FoundTurn:
    """How a laser is turned on the base.

    Attributes
    ----------
    yaw_rad, yaw_std_rad : float
    is_upside_down : bool
    """

    yaw_rad: float
    yaw_std_rad: float
    is_upside_down: bool


def with_found_mounting(log: Source) -> Source | RemountedLog:
    """Give a log whose laser's mounting is only assumed with what its drive tells of it; any other log as it is."""
    source = source_of(log)
    if source.get("laser_pose_from") != "assumed" or "odometry" in source or not isinstance(log, LaserLog):
        return log
    T_laser, T_odom = laser_and_odometry(log)
    found = find_turn(T_laser, T_odom)
    if found is None or not (found.is_upside_down or abs(found.yaw_rad) > MIN_YAW_RAD):
        return log
    pose = (0.0, 0.0, found.yaw_rad)

    def remount(laser: LaserModel) -> LaserModel:
        laser = replace(laser, T_base_laser=pose)
        return upside_down(laser) if found.is_upside_down else laser

    words = ["0.0", "0.0", repr(found.yaw_rad), *(["flip"] if found.is_upside_down else [])]
    told: SourceInfo = {"laser_pose": pose, "laser_pose_from": "the drive", "given_laser_pose": words}
    return RemountedLog(log, remount, warnings=[_warning(found)], source=told, replaces=NOT_TOLD)


def _warning(found: FoundTurn) -> str:
    """What was found, on one line, with what else it may mean."""
    what, doubts = [], []
    if found.is_upside_down:
        what.append("upside down (it turns the opposite way)")
        doubts.append("heading")
    if abs(found.yaw_rad) > MIN_YAW_RAD:
        degrees, std = math.degrees(found.yaw_rad), math.degrees(found.yaw_std_rad)
        what.append(f"turned by {degrees:.0f} +- {std:.1g} degrees")
        if abs(found.yaw_rad) > math.radians(150.0):
            doubts.append("distance")
    doubt = f"if the sign of the odometry's {' or '.join(doubts)} is wrong instead, or to" if doubts else "to"
    return (
        f"tf does not tell how the laser is mounted; against the odometry it is {' and '.join(what)}, and is used so;"
        f" {doubt} settle it, give --laser-pose X Y YAW [flip]"
    )


def by_laser_alone(scan: Scan) -> Scan:
    """A scan as if its laser, the only one, were the base, and nothing else told of the motion."""
    laser = replace(scan.laser, T_base_laser=(0.0, 0.0, 0.0), number=0)
    return replace(scan, laser=laser, T_odom_base=None, odometry=None, imu_yaw=None)


def laser_and_odometry(log: Iterable[Scan]) -> tuple[FloatArray, FloatArray]:
    """Poses (n, 3) of the laser by its scans alone, and of the odometry, over the first metres; of the first laser."""
    config = get_method("graph").config
    assert isinstance(config, PipelineConfig)
    found: list[FloatArray] = []
    told: list[FloatArray] = []
    path_m = turn_rad = 0.0
    with Pipeline(config) as pipeline, beginning_of(log) as scans:
        for scan in scans:
            if scan.laser.number or scan.T_odom_base is None:
                continue
            if told:
                distance_m, angle_rad = se2.distance(told[-1], scan.T_odom_base)
                path_m, turn_rad = path_m + distance_m, turn_rad + angle_rad
            step = pipeline.step(by_laser_alone(scan))
            found.append(step.T_map_base)
            told.append(scan.T_odom_base)
            is_far = path_m > MAX_PATH_M or (path_m > 0.5 * MAX_PATH_M and turn_rad > MAX_TURN_RAD)
            if len(told) == MAX_SCANS or is_far:
                break
    return np.array(found).reshape(-1, 3), np.array(told).reshape(-1, 3)


def find_turn(T_laser: FloatArray, T_odom: FloatArray) -> FoundTurn | None:
    """Find how a laser is turned on the base from its own poses (n, 3) and the odometry's; None: they do not tell."""
    told, found = _joined(T_laser, T_odom)
    if len(told) < MIN_STEPS:
        return None
    is_upside_down = False
    turns = told[:, 2], found[:, 2]
    if min(np.abs(x).sum() for x in turns) > MIN_TURN_RAD:
        correlation = float(turns[0] @ turns[1] / math.sqrt((turns[0] @ turns[0]) * (turns[1] @ turns[1])))
        if abs(correlation) < MIN_CORRELATION:
            return None
        is_upside_down = correlation < 0.0
    if is_upside_down:
        found = found * (1.0, -1.0, -1.0)
    yaw_rad, std_rad = _yaw(told, found)
    if not std_rad < MAX_YAW_STD_RAD:
        return None
    return FoundTurn(yaw_rad=yaw_rad, yaw_std_rad=std_rad, is_upside_down=is_upside_down)


def _joined(T_laser: FloatArray, T_odom: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Increments (k, 3) of odometry and laser, joined until either tells of enough motion."""
    told: list[FloatArray] = []
    found: list[FloatArray] = []
    first = 0
    for k in range(1, len(T_odom)):
        distance_m, turn_rad = se2.distance(T_odom[first], T_odom[k])
        if distance_m > STEP_M or turn_rad > STEP_RAD:
            told.append(se2.between(T_odom[first], T_odom[k]))
            found.append(se2.between(T_laser[first], T_laser[k]))
            first = k
    return np.array(told).reshape(-1, 3), np.array(found).reshape(-1, 3)


def _yaw(told: FloatArray, found: FloatArray) -> tuple[float, float]:
    """Yaw of the laser [rad] and its standard deviation, by least squares that are robust (Cauchy weights)."""
    c, s = np.cos(told[:, 2]) - 1.0, np.sin(told[:, 2])
    x, y = found[:, 0], found[:, 1]
    A = np.vstack([np.column_stack([x, -y, -c, s]), np.column_stack([y, x, -s, -c])])
    b = np.concatenate([told[:, 0], told[:, 1]])
    prior = np.diag([1e-6, 1e-6, OFFSET_STD_M**-2, OFFSET_STD_M**-2])
    weights, scale = np.ones(len(b)), 0.05
    for _ in range(10):
        information = (A * weights[:, None]).T @ A / scale**2 + prior
        solution = np.linalg.solve(information, (A * weights[:, None]).T @ b / scale**2)
        residuals = np.abs(b - A @ solution)
        scale = max(1.4826 * float(np.median(residuals)), 0.005)
        weights = 1.0 / (1.0 + (residuals / (2.0 * scale)) ** 2)
    size = math.hypot(solution[0], solution[1])
    if size < 0.3:
        return 0.0, math.inf
    across = np.array([-solution[1], solution[0], 0.0, 0.0]) / size**2
    std = math.sqrt(float(across @ np.linalg.solve(information, across)))
    return math.atan2(solution[1], solution[0]), std
