"""CARMEN logs: one text line a message; FLASER (the old laser message) or ROBOTLASER1 (the new one)."""

import math
from contextlib import closing
from pathlib import Path

import numpy as np

from slammot_graph.core.errors import ConfigError
from slammot_graph.core.scan import LaserModel
from slammot_graph.core.types import FloatArray
from slammot_graph.logs.base import RawScan, RecordedLog, Records, one_line
from slammot_graph.logs.carmen_geometry import survey_carmen
from slammot_graph.logs.carmen_lines import LaserLine, split_laser_line
from slammot_graph.logs.mounting import laser_pose_source
from slammot_graph.logs.scan_odometry import odometry_of_log
from slammot_graph.logs.scan_stamps import mended
from slammot_graph.logs.source import SkippedScan
from slammot_graph.logs.text_lines import numbered_lines


class CarmenLog(RecordedLog):
    """A CARMEN log, plain or compressed by gzip or bzip2.

    Odometry, stamp and mounting come from the laser's own lines: odometry pose, ipc_timestamp, and laser pose
    seen from the odometry pose. The mounting is one for the whole file: the median over its lines, rounded to
    0.1 mm and 0.1 mrad. FLASER does not contain the laser's maximum range: it is taken as the largest reading of
    the file, which is what the scanner reports where nothing returns. `Scan.odometry` is made of the ODOM lines where
    these agree with the laser's lines, as they are more frequent and not held from one to the next.

    Parameters
    ----------
    path : Path
    laser_pose : (x, y, theta), optional
        The laser in the base [m, m, rad], in place of what the lines say.
    odometry : bool
        False: leave the odometry aside.

    Raises
    ------
    InputError
        The file cannot be read, is damaged, or holds no laser line.
    """

    def __init__(
        self, path: Path, *, laser_pose: tuple[float, float, float] | None = None, odometry: bool = True
    ) -> None:
        survey = survey_carmen(path, laser_pose)
        times = mended(survey.stamps)
        self._stamps = times.stamps
        track = None if times.is_numbered else survey.odometry_lines(self._stamps)
        self._odometry = odometry_of_log(
            survey.T_odom_base, self._stamps, *(track or (None, None)), is_wanted=odometry
        )
        super().__init__(
            path,
            n_scans=survey.n_scans,
            opening_warnings=(*survey.warnings, *times.warnings, *self._odometry.warnings),
            source={
                **laser_pose_source(survey.T_base_laser, survey.mounting_told_by),
                **self._odometry.source,
            },
        )
        self._survey = survey

    def _records(self) -> Records:
        kind = self._survey.kind
        prefix = kind.encode() + b" "
        lasers = _Lasers(self._survey.T_base_laser)
        record = -1
        with closing(numbered_lines(self.path)) as lines:
            for number, line in lines:
                if not line.startswith(prefix):
                    continue
                place = f"line {number}"
                record += 1
                if record == self.n_scans:  # the file has grown since
                    return
                try:
                    parts = split_laser_line(kind, line.split())
                    ranges = _numbers(parts.ranges)
                    yield RawScan(
                        place=place,
                        stamp=self._stamp(record, parts.stamp),
                        ranges=ranges,
                        laser=self._laser(parts, lasers),
                        T_odom_base=self._odometry.of(record, _numbers(parts.laser_and_base[3:])),
                        odometry=self._odometry.track,
                    )
                except (ValueError, ConfigError) as err:
                    yield SkippedScan(place=place, reason=one_line(err))

    def _stamp(self, record: int, told: bytes) -> float:
        """Stamp of a line [s], mended; ValueError where the file holds no number."""
        float(told)
        return float(self._stamps[record])

    def _laser(self, parts: LaserLine, lasers: "_Lasers") -> LaserModel:
        """The laser that took a line's scan."""
        n_beams = len(parts.ranges)
        if parts.geometry:
            _, start, _, resolution, max_range, _, _ = _numbers(parts.geometry).tolist()
            return lasers.get(start, resolution, n_beams, max_range)
        if n_beams != self._survey.n_beams:
            raise ValueError(f"{n_beams} beams where the log's first scan has {self._survey.n_beams}")
        n_steps = n_beams if n_beams % 2 == 0 else n_beams - 1  # 181 and 361 beams include both ends
        range_max = (
            self._survey.largest_reading_m or math.inf
        )  # no reading at all: every scan will be left out
        return lasers.get(-math.pi / 2, math.pi / max(n_steps, 1), n_beams, range_max)


class _Lasers:
    """Laser models of one mounting, each geometry made once."""

    def __init__(self, T_base_laser: tuple[float, float, float]) -> None:
        self._T_base_laser = T_base_laser
        self._models: dict[tuple[float, float, int, float], LaserModel] = {}

    def get(self, angle_min: float, angle_increment: float, n_beams: int, range_max: float) -> LaserModel:
        """The model of a geometry [rad, rad, count, m].

        Raises
        ------
        ConfigError
            There can be no such laser.
        """
        key = (angle_min, angle_increment, n_beams, range_max)
        if key not in self._models:
            self._models[key] = LaserModel(
                angle_min=angle_min,
                angle_increment=angle_increment,
                n_beams=n_beams,
                range_min=0.0,
                range_max=range_max,
                T_base_laser=self._T_base_laser,
            )
        return self._models[key]


def _numbers(tokens: list[bytes]) -> FloatArray:
    """Numbers of text tokens; ValueError for those that are none."""
    return np.array(tokens, dtype=np.float64)
