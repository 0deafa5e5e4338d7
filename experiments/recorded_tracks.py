"""Tracks on recorded logs: the other car of datmo's bags, and the labelled persons of the wheelchair bag."""

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader

from experiments.recorded_logs import WALKERS, person_labels
from slammot_graph import Run, open_log
from slammot_graph.core import se2
from slammot_graph.core.results import RunResult
from slammot_graph.core.types import FloatArray

VEHICLE_BAGS = ("overtakes", "parallel")
WALKER_BAG = "general_tracking_moving_1.bag"
_T_EGO_LASER: FloatArray = np.array([-0.12, 0.095, np.radians(1.7)])
_NEAR_M = 0.5


def poses_of(bag: Path, topic: str) -> FloatArray:
    """(n, 4) stamps [s] and poses that a topic tells; the headings run on."""
    rows = []
    with AnyReader([bag]) as reader:
        for connection, _, raw in reader.messages([c for c in reader.connections if c.topic == topic]):
            message: Any = reader.deserialize(raw, connection.msgtype)
            pose, stamp = message.pose, message.header.stamp
            pose = getattr(pose, "pose", pose)
            q = pose.orientation
            heading = np.arctan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y**2 + q.z**2))
            rows.append((stamp.sec + 1e-9 * stamp.nanosec, pose.position.x, pose.position.y, heading))
    found = np.array(rows)
    found[:, 3] = np.unwrap(found[:, 3])
    return found


def vehicle_scores(bag: Path) -> dict[str, float]:
    """How one identity follows the other car, against its marker's pose; `online` and `final` figures.

    The origin of the marker's pose is not the middle of the car: `spread` is the error less its mean in the car's own
    axes, and `pull` how far that points towards the laser: a box of which the far side was never seen lies too near.
    """
    result = Run(open_log(bag, odom_topic="/ego_pose"), "graph").complete()
    ego, other = (
        np.column_stack([np.interp(result.stamps, poses[:, 0], poses[:, k]) for k in (1, 2, 3)])
        for poses in (poses_of(bag, "/ego_pose"), poses_of(bag, "/red_pose"))
    )
    truth = se2.between(ego, other)
    scores: dict[str, float] = {}
    for labels, rows, T in _both(result):
        k = np.searchsorted(result.stamps, rows[:, 0] - 1e-6)
        inside = se2.transform(se2.inverse(T[k]), rows[:, None, 2:4])
        offset = se2.transform(_T_EGO_LASER, inside)[:, 0] - truth[k, :2]
        ids, is_near = rows[:, 1], np.hypot(offset[:, 0], offset[:, 1]) < _NEAR_M
        numbers, counts = np.unique(ids[is_near], return_counts=True)
        is_own = is_near & (ids == numbers[counts.argmax()])
        R = se2.rotation(truth[k[is_own], 2])
        own = np.einsum("mji,mj->mi", R, offset[is_own])
        spread = own - own.mean(axis=0)
        to_laser = -np.einsum("mji,mj->mi", R, truth[k[is_own], :2])
        to_laser /= np.hypot(to_laser[:, 0], to_laser[:, 1])[:, None]
        scores |= {
            f"{labels} share": len(np.unique(k[is_own])) / len(result.stamps),
            f"{labels} ids": float(len(numbers)),
            f"{labels} position_m": float(np.sqrt(np.square(own).sum(axis=1).mean())),
            f"{labels} spread_m": float(np.sqrt(np.square(spread).sum(axis=1).mean())),
            f"{labels} pull_m": float((spread * to_laser).sum(axis=1).mean()),
            f"{labels} false": float(len(np.setdiff1d(ids, numbers))),
        }
    return scores


def walker_scores(bag: Path) -> dict[str, float]:
    """How many labels of walking persons have a track within 0.5 m; a label belongs to the scan before it."""
    result = Run(open_log(bag), "graph").complete()
    labels = [(k, place) for k, person, place in person_labels(bag, list(open_log(bag))) if person in WALKERS]
    scores: dict[str, float] = {"labels": float(len(labels))}
    for name, rows, T in _both(result):
        n_near = 0
        for k, place in labels:
            seen = rows[np.abs(rows[:, 0] - result.stamps[k]) < 1e-4, 2:4]
            away = np.hypot(*(seen - se2.transform(T[k], place[None])).T)
            n_near += bool((away < _NEAR_M).any())
        scores[f"{name} near"] = float(n_near)
    return scores


def _both(result: RunResult) -> list[tuple[str, FloatArray, FloatArray]]:
    return [
        ("online", result.tracks_online, result.T_map_base_online),
        ("final", result.tracks, result.T_map_base),
    ]
