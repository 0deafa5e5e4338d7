"""Odometry in doubt: its velocity has changed from one scan to the next as this robot's never did, or it is dead.

An encoder that sticks, dies or counts backward does so at once, where a robot takes its time. Where walls tell of the
way, the match says who is right. Down a corridor, which agrees with any way along it, the robot moves as told or goes
on as before, and the way is as uncertain as both are apart: their distance is one error, which all scans since share.
Odometry that has told of no motion yet may be dead as soon as a match did.
"""

import math
from dataclasses import dataclass

import numpy as np

from slammot_graph.core.checks import Checked, Positive, PositiveShare
from slammot_graph.core.types import FloatArray
from slammot_graph.odometry.motion import NO_DOUBT, MatchedPose, Motion

USUAL_GAIN = 0.5
"""Weight of the latest velocity in the usual one."""


@dataclass(frozen=True, kw_only=True)
class DoubtConfig(Checked):
    """When odometry is in doubt, and when no more.

    Attributes
    ----------
    begin_sigmas, end_sigmas : float
        A change of velocity of more standard deviations begins a doubt; the odometry is as it was before once it tells
        of that velocity again, to within so many.
    usual_acceleration_m_s2 : float
        Standard deviation that any robot may have, beside what is learnt of this one's odometry.
    first_change_m_s : float
        That begins here: the standard deviation of a scan's velocity from the usual one. Of odometry that has told of
        no motion yet, while a match did, it is that of the motion as well [m/s, rad/s].
    gain, clip : float
        Weight of the latest change in it, which counts for no more than this times the standard deviation.
    decide_sigmas : float
        A match that tells of the way decides where both ways are so many of its standard deviations apart.
    moved_sigmas : float
        A match tells of a motion that is so many of its standard deviations.
    dead_way_m : float
        Odometry is dead that repeats its pose exactly while reliable matches lead farther.
    """

    begin_sigmas: Positive = 4.0
    end_sigmas: Positive = 3.0
    usual_acceleration_m_s2: Positive = 0.5
    first_change_m_s: Positive = 0.2
    gain: PositiveShare = 0.05
    clip: Positive = 4.0
    decide_sigmas: Positive = 3.0
    moved_sigmas: Positive = 4.0
    dead_way_m: Positive = 0.5


class OdometryDoubt:
    """Whether the odometry is in doubt, how far apart both ways are since, and whether it is dead.

    Attributes
    ----------
    config : DoubtConfig
    is_in_doubt : bool
    apart_m : float
        Standard deviation that the way has for that [m].
    """

    def __init__(self, config: DoubtConfig) -> None:
        self.config = config
        self.is_in_doubt = False
        self.apart_m = 0.0
        self._var_change = config.first_change_m_s**2
        self._velocity: tuple[float, float] | None = None
        self._step: FloatArray = NO_DOUBT
        self._step_s = 0.0
        self._stood_at: FloatArray | None = None
        self._way_unmoved_m = 0.0
        self._has_moved = self._may_be_dead = False

    @property
    def is_dead(self) -> bool:
        """Whether the odometry repeats its pose while the robot moves."""
        return self._way_unmoved_m > self.config.dead_way_m

    def start_scan(
        self, told: Motion | None, previous: FloatArray, step_s: float, *, is_comparable: bool = True
    ) -> None:
        """Move on to the next scan.

        Parameters
        ----------
        told : Motion or None
            Since the scan before, by the odometry; None: it tells nothing.
        previous : (3,) array
            What the previous motion makes of it.
        step_s : float
        is_comparable : bool
            Its velocity can be compared with that before: not where another laser's scan lies between, where the
            stamps are not steady, or where no robot moves so.
        """
        self._step, self._step_s = NO_DOUBT, step_s
        if told is not None and told.increment.any():
            self._stood_at, self._way_unmoved_m = None, 0.0
            self._has_moved, self._may_be_dead = True, False
        if told is None or not is_comparable or step_s <= 0.0:
            self.end()
            return
        config, (x, y, _) = self.config, told.increment.tolist()
        x, y = x / step_s, y / step_s
        if self._velocity is None:
            self._velocity = x, y
            return
        usual_x, usual_y = self._velocity
        change2 = (x - usual_x) ** 2 + (y - usual_y) ** 2
        var = self._var_change + (config.usual_acceleration_m_s2 * step_s) ** 2
        if self.is_in_doubt:
            self.is_in_doubt = change2 >= config.end_sigmas**2 * var
        else:
            by_matches_x, by_matches_y = previous[0] / step_s, previous[1] / step_s
            was_right = math.hypot(by_matches_x - usual_x, by_matches_y - usual_y) < math.hypot(
                by_matches_x - x, by_matches_y - y
            )
            self.is_in_doubt = was_right and change2 > config.begin_sigmas**2 * var
            most2 = config.clip**2 * self._var_change
            self._var_change += config.gain * (min(change2, most2) - self._var_change)
            self.apart_m = 0.0
        if self.is_in_doubt:
            self._step = np.array([(x - usual_x) * step_s, (y - usual_y) * step_s])
        else:
            self._velocity = usual_x + USUAL_GAIN * (x - usual_x), usual_y + USUAL_GAIN * (y - usual_y)

    def end(self) -> None:
        """Begin anew, as after a scan that was not matched: how fast the robot was is not known any more."""
        self.is_in_doubt, self._velocity = False, None

    def widened(self, told: Motion) -> Motion:
        """Give the odometry's motion with what a doubt adds to its covariance."""
        if self._may_be_dead:
            std = self.config.first_change_m_s * self._step_s
            return told._replace(cov=told.cov + std * std * np.eye(3))
        if self._step is NO_DOUBT:
            return told
        step_m = math.hypot(*self._step)
        before_m, self.apart_m = self.apart_m, self.apart_m + step_m
        along, cov = self._step / step_m, told.cov.copy()
        cov[:2, :2] += (self.apart_m**2 - before_m**2) * np.outer(along, along)
        return told._replace(cov=cov, doubt=along)

    def learn(self, told: FloatArray, found: FloatArray, match: MatchedPose) -> None:
        """Let a match decide that found a motion (3,) where the odometry told of another (3,)."""
        if match.is_reliable and not told.any():
            at = match.T_local_base[:2]
            self._stood_at = at if self._stood_at is None else self._stood_at
            self._way_unmoved_m = math.hypot(*(at - self._stood_at))
            if not self._has_moved:
                squared = float(found[:2] @ np.linalg.solve(match.cov[:2, :2], found[:2]))
                self._may_be_dead |= squared > self.config.moved_sigmas**2
        if self._step is NO_DOUBT or not match.is_told:
            return
        step_m = math.hypot(*self._step)
        along = self._step / step_m
        var = float(along @ match.cov[:2, :2] @ along)
        self.apart_m *= math.sqrt(var / (self.apart_m**2 + var))
        if step_m > self.config.decide_sigmas * math.sqrt(var):
            self.is_in_doubt = abs(float(along @ (found - told)[:2])) > 0.5 * step_m
