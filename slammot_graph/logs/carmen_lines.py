"""The fields of CARMEN's laser lines, as tokens."""

from typing import NamedTuple

KINDS = ("FLASER", "ROBOTLASER1", "RLASER")
"""Laser messages, the best first; a log is read by one kind, as the others repeat it or look elsewhere."""


class LaserLine(NamedTuple):
    """Tokens of one laser line.

    Attributes
    ----------
    geometry : list of bytes
        ROBOTLASER1: type, start angle, field of view, resolution, maximum range, accuracy, remission mode;
        empty for FLASER.
    ranges : list of bytes
    laser_and_base : list of six bytes
        Laser pose and robot pose, both in odom.
    stamp : bytes
        ipc_timestamp, the third token from the end.
    """

    geometry: list[bytes]
    ranges: list[bytes]
    laser_and_base: list[bytes]
    stamp: bytes


def split_laser_line(kind: str, tokens: list[bytes]) -> LaserLine:
    """Find the fields of a laser line of one of `KINDS`.

    Raises
    ------
    ValueError
        The line does not have as many tokens as its counts say.
    """
    if kind == "ROBOTLASER1":
        return _split_robotlaser(tokens)
    return _split_flaser(tokens)


def _split_flaser(tokens: list[bytes]) -> LaserLine:
    """``FLASER n r1..rn laser(3) odom(3) ipc_timestamp ipc_hostname logger_timestamp``."""
    end = 2 + _count(tokens, 1)
    _check_length(tokens, end + 9)
    return LaserLine([], tokens[2:end], tokens[end : end + 6], tokens[-3])


def _split_robotlaser(tokens: list[bytes]) -> LaserLine:
    """``ROBOTLASER1 geometry(7) n r1..rn m rem1..remm laser(3) robot(3) others(5)`` and the ending."""
    end = 9 + _count(tokens, 8)
    poses = end + 1 + _count(tokens, end)
    _check_length(tokens, poses + 14)
    return LaserLine(tokens[1:8], tokens[9:end], tokens[poses : poses + 6], tokens[-3])


def _count(tokens: list[bytes], position: int) -> int:
    if len(tokens) <= position:
        raise ValueError("the line is truncated")
    count = int(tokens[position])
    if count < 0:
        raise ValueError(f"a count of {count}")
    return count


def _check_length(tokens: list[bytes], n_expected: int) -> None:
    if len(tokens) != n_expected:
        raise ValueError(f"{len(tokens)} tokens where its counts ask for {n_expected}")
