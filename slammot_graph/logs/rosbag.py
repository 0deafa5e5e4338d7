"""ROS 1 and ROS 2 bags: LaserScan, with odometry from a topic or from tf and an IMU where there are any."""

from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from slammot_graph.core.errors import ConfigError, InputError
from slammot_graph.core.log_info import SourceInfo
from slammot_graph.core.odometry_track import MAX_HOLD_S, OdometryTrack
from slammot_graph.core.scan import LaserModel
from slammot_graph.core.types import FloatArray
from slammot_graph.logs.bag_cloud_lasers import cloud_place, find_slicers
from slammot_graph.logs.bag_clouds import CloudSlice, CloudSlicer, cloud_points
from slammot_graph.logs.bag_imu import YawTrack, read_yaw
from slammot_graph.logs.bag_messages import BagMessage, frame_name, open_bag
from slammot_graph.logs.bag_mounting import FoundMounting
from slammot_graph.logs.bag_odometry import (
    MAX_CLOCK_DIFFERENCE_S,
    BagOdometry,
    FrameNames,
    base_frames,
    read_odometry,
    sample_arrays,
    share_a_clock,
    why_left_out,
)
from slammot_graph.logs.bag_restarts import told_restarts
from slammot_graph.logs.bag_scans import (
    ScanHeaders,
    find_lasers,
    lags_differ,
    order_of_scans,
    read_scan_headers,
    topic_names,
)
from slammot_graph.logs.bag_topics import choose_cloud_topic, choose_imu_topic, choose_scan_topics
from slammot_graph.logs.base import RawScan, RecordedLog, Records, one_line
from slammot_graph.logs.mounting import GivenPoses, laser_pose_source
from slammot_graph.logs.scan_odometry import ScanOdometry, are_sane_poses, no_odometry, odometry_of_log
from slammot_graph.logs.scan_stamps import mended
from slammot_graph.logs.source import SkippedScan
from slammot_graph.logs.sweep_times import SweepTimes, sweep_times

MAX_BEAM_COUNT_ERROR = 1.5
"""Largest difference between a scan's count of beams and the count from its angles."""


@dataclass(frozen=True, kw_only=True)
class BagChoices:
    """What of a bag to use where several would do, or in place of what it says.

    Attributes
    ----------
    scan_topics : sequence of str
        Those of all lasers to use; empty: the only one.
    odom_topic, imu_topic : str, optional
        A tf topic may serve as odometry.
    frames : FrameNames
        Of odometry and base.
    laser_poses : GivenPoses
        Lasers in the base, in place of what tf says.
    odometry : bool
        False: leave the odometry aside.
    cloud_topic : str, optional
        Clouds of a 3D lidar, of which scans are made, in place of the scans.
    heights : CloudSlice, optional
        Their slice.
    """

    scan_topics: tuple[str, ...] = ()
    odom_topic: str | None = None
    imu_topic: str | None = None
    frames: FrameNames = field(default_factory=FrameNames)
    laser_poses: GivenPoses = field(default_factory=dict)
    odometry: bool = True
    cloud_topic: str | None = None
    heights: CloudSlice | None = None


class RosbagLog(RecordedLog):
    """A bag, read in two passes: one for stamps, odometry and tf on opening, one for the scans each time.

    Odometry is interpolated to the scan's stamp. Stamps are the headers' (a scan is recorded only after its
    sweep and the delay of the driver), unless the headers of scans and odometry do not share a clock: then
    recording times are used for both, with a warning. Scans of several lasers, of one topic or of several, are used
    in the order of their stamps, each by its own mounting.

    Parameters
    ----------
    path : Path
        A ``.bag``, a ROS 2 bag folder, a ``.db3`` or a ``.mcap`` file.
    choices : BagChoices

    Raises
    ------
    InputError
        The bag cannot be read; it lacks scans; several topics would do; a topic is not there.
    """

    def __init__(self, path: Path, choices: BagChoices) -> None:
        with open_bag(path) as bag:
            if choices.cloud_topic is None:
                self._scan_topics = choose_scan_topics(path, bag.topics, choices.scan_topics)
            else:
                self._scan_topics = [choose_cloud_topic(path, bag.topics, choices.cloud_topic)]
            headers = read_scan_headers(bag, self._scan_topics)
            n_scans = len(headers.stamps)
            found = BagOdometry()
            if choices.odometry:
                found = read_odometry(bag, choices.odom_topic, choices.frames, n_scans=n_scans)
            bases = base_frames(found.samples, choices.frames.base)
            lasers = find_lasers(bag, self._scan_topics, headers.frames, bases, choices.laser_poses)
            self._slicers: dict[str, CloudSlicer] = {}
            if choices.heights is not None:
                places = {x: cloud_place(bag, bases, x, lasers.mountings[x]) for x in lasers.mountings}
                self._slicers = find_slicers(bag, self._scan_topics, places, choices.heights)
            stamps, uses_headers, warnings = _stamps(headers, found)
            order = order_of_scans(stamps, headers.laser)
            self._stamps, self._place = stamps[order], np.argsort(order)
            self._laser_of = headers.laser[order]
            self._odometry, self._track, more = _odometry(
                path, found, self._stamps, uses_headers=uses_headers, is_wanted=choices.odometry
            )
            imu_topic, imu_warning = choose_imu_topic(path, bag.topics, choices.imu_topic)
            self._yaw: YawTrack | None = None
            if imu_topic is not None:
                self._yaw = read_yaw(bag, imu_topic, bases, uses_headers=uses_headers)
        self._mountings, self._numbers = lasers.mountings, headers.numbers
        self._sweeps: dict[tuple[float, int, float, int], SweepTimes] = {}
        source: SourceInfo = {"scan_topic": topic_names(self._scan_topics)}
        if choices.cloud_topic is not None and choices.heights is not None:
            source = {
                "cloud_topic": self._scan_topics[0].name,
                "slice": (choices.heights.z_min_m, choices.heights.z_max_m),
            }
        if len(headers.numbers) > 1:
            source["lasers"] = [
                {"topic": topic, "frame": frame, "n_scans": int(np.count_nonzero(headers.laser == number))}
                | _mounting_source(lasers.mountings.get(frame))
                for (topic, frame), number in headers.numbers.items()
            ]
        given = {
            "odom_topic": found.topic,
            "odom_frame": choices.frames.odom,
            "base_frame": choices.frames.base,
        }
        source.update(SourceInfo(**{key: name for key, name in given.items() if name}))  # type: ignore[typeddict-item]
        if imu_topic is not None:
            source["imu_topic"] = imu_topic.name
        source.update(laser_pose_source(lasers.first.mounting.T_base_laser, lasers.first.told_by))
        source.update(self._odometry.source)
        super().__init__(
            path,
            n_scans=n_scans,
            opening_warnings=[x for x in (*lasers.warnings, *warnings, *more, imu_warning) if x],
            source=source,
        )

    def _records(self) -> Records:
        lasers: dict[tuple[float | str, ...], LaserModel] = {}
        with open_bag(self.path) as bag, closing(bag.messages(self._scan_topics)) as messages:
            waiting: dict[int, RawScan | SkippedScan] = {}
            n_given = 0
            for message in messages:
                if message.number > self.n_scans:  # the bag has grown since
                    return
                place = f"message {message.number} of {message.topic}"
                record: RawScan | SkippedScan
                try:
                    record = self._decode(place, message, lasers)
                except (ValueError, ConfigError) as err:
                    record = SkippedScan(place=place, reason=one_line(err))
                waiting[int(self._place[message.number - 1])] = record
                while n_given in waiting:
                    yield waiting.pop(n_given)
                    n_given += 1

    def _decode(
        self, place: str, message: BagMessage, lasers: dict[tuple[float | str, ...], LaserModel]
    ) -> RawScan:
        scan, record = message.content, int(self._place[message.number - 1])
        if scan is None:
            raise ValueError("the message cannot be decoded")
        frame = frame_name(scan.header.frame_id)
        found = self._mountings.get(frame)
        if found is None:
            raise ValueError(f"it is not known where frame {frame or '(unnamed)'} sits on the robot")
        stamp = float(self._stamps[record])
        if frame in self._slicers:
            laser = self._slicers[frame].laser
            ranges, beam_times = self._slicers[frame].sweep(*cloud_points(scan))
        else:
            laser = _laser(scan, (frame, self._numbers[message.topic, frame]), found, lasers)
            with np.errstate(invalid="ignore"):  # a signalling NaN in a range is just an invalid beam
                ranges = scan.ranges.astype(np.float64)
            beam_times = self._beam_times(scan, laser, message.topic)
        return RawScan(
            place=place,
            stamp=stamp,
            ranges=ranges,
            laser=laser,
            T_odom_base=self._T_odom_base(record, stamp),
            odometry=self._odometry.track,
            imu_yaw=None if self._yaw is None else self._yaw.at(stamp),
            beam_times=beam_times,
        )

    def _beam_times(self, scan: Any, laser: LaserModel, topic: str) -> FloatArray | None:
        """(n,) times of a scan's beams since its stamp [s]; warns once of those that cannot be right."""
        key = float(scan.time_increment), laser.n_beams, laser.angle_increment, laser.number
        if key not in self._sweeps:
            own_stamps = self._stamps[self._laser_of == laser.number]
            self._sweeps[key] = sweep_times(key[0], own_stamps, laser, f"time_increment of {topic}")
        self.warnings.extend(w for w in self._sweeps[key].warnings if w not in self.warnings)
        return self._sweeps[key].beam_times

    def _T_odom_base(self, record: int, stamp: float) -> FloatArray | None:
        """(3,) odometry of a scan; None: use it without."""
        if self._track is None or self._odometry.is_optional[record]:
            return None
        T_odom_base = self._track.at(stamp)
        if T_odom_base is None:
            raise ValueError(f"no odometry within {MAX_HOLD_S} s of its stamp")
        return T_odom_base


def _laser(
    scan: Any,
    name: tuple[str, int],
    found: FoundMounting,
    lasers: dict[tuple[float | str, ...], LaserModel],
) -> LaserModel:
    """The laser that took a scan; if it is mounted upside down, the order of the angles is reversed."""
    n_beams = len(scan.ranges)
    key = (
        *name,
        scan.angle_min,
        scan.angle_max,
        scan.angle_increment,
        n_beams,
        scan.range_min,
        scan.range_max,
    )
    if key not in lasers:
        span, step = scan.angle_max - scan.angle_min, scan.angle_increment
        if not abs(n_beams * step - span) <= MAX_BEAM_COUNT_ERROR * abs(step):
            raise ValueError(
                f"{n_beams} beams contradict a span of {span:.4f} rad in steps of {step:.6f} rad"
            )
        sense = -1.0 if found.mounting.is_upside_down else 1.0
        lasers[key] = LaserModel(
            angle_min=sense * scan.angle_min,
            angle_increment=sense * step,
            n_beams=n_beams,
            range_min=scan.range_min,
            range_max=scan.range_max,
            T_base_laser=found.mounting.T_base_laser,
            number=name[1],
        )
    return lasers[key]


def _mounting_source(found: FoundMounting | None) -> dict[str, object]:
    """What a summary says of a laser's place on the robot."""
    if found is None:
        return {"is_used": False}
    mounting = found.mounting
    return {
        "laser_pose": mounting.T_base_laser,
        "is_upside_down": mounting.is_upside_down,
        "laser_pose_from": found.told_by,
    }


def _stamps(headers: ScanHeaders, found: BagOdometry) -> tuple[FloatArray, bool, list[str]]:
    """Stamps of the scans (n,) [s], whether they are the headers', and warnings."""
    by_header = mended(headers.stamps)
    main = headers.laser == headers.laser[headers.laser >= 0][0]
    of_odometry = np.array([sample.header_stamp for sample in found.samples])
    restarted = told_restarts(headers.stamps[main], headers.bag_stamps[main], of_odometry)
    if restarted:
        by_recorder = mended(headers.bag_stamps)
        return by_recorder.stamps, False, [restarted, *by_recorder.warnings]
    has_clock = share_a_clock(headers.stamps, headers.bag_stamps, found.samples)
    if len(headers.numbers) > 1 and lags_differ(headers, MAX_CLOCK_DIFFERENCE_S):
        has_clock = False
    if has_clock and not by_header.is_numbered:
        return by_header.stamps, True, list(by_header.warnings)
    by_recorder = mended(headers.bag_stamps)
    what = "header stamps of scans and odometry do not share a clock"
    if not found.samples or by_header.is_numbered:
        what = f"header stamps of the scans do not rise{' and' if found.samples else ''}"
        what += " do not share a clock with the odometry" if found.samples else ""
    return by_recorder.stamps, False, [f"{what}; recording times are used instead", *by_recorder.warnings]


def _odometry(
    path: Path, found: BagOdometry, scan_stamps: FloatArray, *, uses_headers: bool, is_wanted: bool
) -> tuple[ScanOdometry, OdometryTrack | None, list[str]]:
    """Odometry of the scans with the track to interpolate in, and warnings."""
    if not is_wanted or not found.samples:
        if is_wanted:
            told = no_odometry(len(scan_stamps), found.why_none)
        else:
            told = odometry_of_log(None, scan_stamps, is_wanted=False)
        return told, None, list(told.warnings)
    stamps, poses = sample_arrays(found.samples, uses_headers=uses_headers)
    stamps = mended(stamps).stamps
    is_sane = are_sane_poses(poses)
    if not is_sane.any():
        raise InputError(
            f"{path}: none of the {len(poses)} odometry poses is finite; choose another --odom-topic"
        )
    track = OdometryTrack.from_samples(stamps[is_sane], poses[is_sane])
    told = odometry_of_log(track.at_many(scan_stamps), scan_stamps, stamps, poses)
    return told, track, [x for x in (why_left_out(poses), *told.warnings) if x]
