"""ROS 1 and ROS 2 bags: LaserScan with odometry from a topic or from tf."""

from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from slammot_graph.core.errors import ConfigError, InputError
from slammot_graph.core.scan import LaserModel
from slammot_graph.logs.bag_messages import Bag, BagMessage, frame_name, header_stamp, open_bag
from slammot_graph.logs.bag_mounting import find_mounting
from slammot_graph.logs.bag_odometry import base_frames, odometry_track, read_odometry, share_a_clock
from slammot_graph.logs.bag_topics import Topic, choose_odometry_topic, choose_scan_topic, tf_topic
from slammot_graph.logs.base import RawScan, RecordedLog, Records, one_line
from slammot_graph.logs.mounting import laser_pose_source
from slammot_graph.logs.odometry import MAX_HOLD_S
from slammot_graph.logs.source import SkippedScan

MAX_BEAM_COUNT_ERROR = 1.5
"""Largest difference between a scan's count of beams and the count from its angles."""

N_SCANS_SAMPLED = 20
"""Scans looked at on opening, to learn the laser's frame and clock."""


class RosbagLog(RecordedLog):
    """A bag, read in two passes: a light one for odometry and tf on opening, one for the scans each time.

    Odometry is interpolated to the scan's stamp. Stamps are the headers' (a scan is recorded only after its
    sweep and the delay of the driver), unless the headers of scans and odometry do not share a clock: then
    recording times are used for both, with a warning.

    Parameters
    ----------
    path : Path
        A ``.bag``, a ROS 2 bag folder, a ``.db3`` or a ``.mcap`` file.
    scan_topic, odom_topic : str, optional
        Which topics to use where several would do; a tf topic may serve as odometry.
    laser_pose : (x, y, theta), optional
        The laser in the base [m, m, rad], in place of what tf says.

    Raises
    ------
    InputError
        The bag cannot be read; it lacks scans or odometry; several topics would do; a topic is not there.
    """

    def __init__(
        self,
        path: Path,
        *,
        scan_topic: str | None = None,
        odom_topic: str | None = None,
        laser_pose: tuple[float, float, float] | None = None,
    ) -> None:
        with open_bag(path) as bag:
            self._scan_topic = choose_scan_topic(path, bag.topics, scan_topic)
            n_scans = self._scan_topic.n_messages
            odometry_topic = choose_odometry_topic(path, bag.topics, odom_topic, n_scans=n_scans)
            scans = _first_scans(bag, self._scan_topic)
            samples = read_odometry(bag, odometry_topic)
            laser_frame = frame_name(scans[0].content.header.frame_id)
            found = find_mounting(bag, base_frames(samples), laser_frame, laser_pose)
            odom_topic = odometry_topic.name if odometry_topic else tf_topic(bag.topics)
        self._mounting = found.mounting
        warnings = list(found.warnings)
        self._uses_headers = share_a_clock(scans, samples)
        if not self._uses_headers:
            warnings.append(
                "header stamps of scans and odometry do not share a clock; recording times are used instead"
            )
        self._odometry, odometry_warnings = odometry_track(path, samples, uses_headers=self._uses_headers)
        super().__init__(
            path,
            n_scans=n_scans,
            opening_warnings=[*warnings, *odometry_warnings],
            source={
                "scan_topic": self._scan_topic.name,
                "odom_topic": odom_topic,
                **laser_pose_source(self._mounting.T_base_laser, found.told_by),
            },
        )

    def _records(self) -> Records:
        lasers: dict[tuple[float, ...], LaserModel] = {}
        with open_bag(self.path) as bag, closing(bag.messages([self._scan_topic])) as messages:
            for message in messages:
                place = f"message {message.number} of {self._scan_topic.name}"
                try:
                    yield self._decode(place, message, lasers)
                except (ValueError, ConfigError) as err:
                    yield SkippedScan(place=place, reason=one_line(err))

    def _decode(
        self, place: str, message: BagMessage, lasers: dict[tuple[float, ...], LaserModel]
    ) -> RawScan:
        scan = message.content
        if scan is None:
            raise ValueError("the message cannot be decoded")
        laser = self._laser(scan, lasers)
        stamp = header_stamp(scan) if self._uses_headers else message.bag_stamp
        T_odom_base = self._odometry.at(stamp)
        if T_odom_base is None:
            raise ValueError(f"no odometry within {MAX_HOLD_S} s of its stamp")
        with np.errstate(invalid="ignore"):  # a signalling NaN in a range is just an invalid beam
            ranges = scan.ranges.astype(np.float64)
        return RawScan(
            place=place,
            stamp=stamp,
            ranges=ranges,
            laser=laser,
            T_odom_base=T_odom_base,
        )

    def _laser(self, scan: Any, lasers: dict[tuple[float, ...], LaserModel]) -> LaserModel:
        """The laser that took a scan; if it is mounted upside down, the order of the angles is reversed."""
        n_beams = len(scan.ranges)
        key = (scan.angle_min, scan.angle_max, scan.angle_increment, n_beams, scan.range_min, scan.range_max)
        if key not in lasers:
            span, step = scan.angle_max - scan.angle_min, scan.angle_increment
            if not abs(n_beams * step - span) <= MAX_BEAM_COUNT_ERROR * abs(step):
                raise ValueError(
                    f"{n_beams} beams contradict a span of {span:.4f} rad in steps of {step:.6f} rad"
                )
            sense = -1.0 if self._mounting.is_upside_down else 1.0
            lasers[key] = LaserModel(
                angle_min=sense * scan.angle_min,
                angle_increment=sense * step,
                n_beams=n_beams,
                range_min=scan.range_min,
                range_max=scan.range_max,
                T_base_laser=self._mounting.T_base_laser,
            )
        return lasers[key]


def _first_scans(bag: Bag, topic: Topic) -> list[BagMessage]:
    with closing(bag.messages([topic])) as messages:
        scans = [x for x in islice(messages, N_SCANS_SAMPLED) if x.content is not None]
    if not scans:
        raise InputError(f"{bag.path}: the messages of {topic.name} cannot be decoded; record the bag again")
    return scans
