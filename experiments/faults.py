"""The faults of the odometry that `odometry_faults` tries, and the calibration that each asks for."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from slammot_graph.simulation import SimulatedLog, odometry_faults


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A fault of the odometry, and what calibration it asks for.

    Attributes
    ----------
    apply : function
        The log with the fault.
    delay_s, distance, heading, bias_rad_per_m : float
        Delay, factors on distance and turn, and bias: what is to be found besides the simulated odometry's own errors.
    is_steady : bool
        The fault is the same all along, so that these can be found.
    """

    apply: Callable[[SimulatedLog], SimulatedLog]
    delay_s: float = 0.0
    distance: float = 1.0
    heading: float = 1.0
    bias_rad_per_m: float = 0.0
    is_steady: bool = False


def _late(delay_s: float) -> Fault:
    return Fault(apply=lambda log: odometry_faults.late(log, delay_s), delay_s=delay_s, is_steady=True)


def _scaled(factor: float) -> Fault:
    return Fault(apply=lambda log: odometry_faults.scaled(log, factor), distance=factor, is_steady=True)


def _turned(factor: float) -> Fault:
    return Fault(apply=lambda log: odometry_faults.turned(log, factor), heading=factor, is_steady=True)


def _biased(bias: float) -> Fault:
    return Fault(apply=lambda log: odometry_faults.biased(log, bias), bias_rad_per_m=bias, is_steady=True)


NONE = "none"
FAULTS: Mapping[str, Fault] = {
    NONE: Fault(apply=lambda log: log, is_steady=True),
    "late by 0.1 s": _late(0.1),
    "late by 0.25 s": _late(0.25),
    "late by 0.5 s": _late(0.5),
    "early by 0.25 s": _late(-0.25),
    "distance x 0.3": _scaled(0.3),
    "distance x 0.6": _scaled(0.6),
    "distance x 1.25": _scaled(1.25),
    "distance x 3": _scaled(3.0),
    "distance x -1": _scaled(-1.0),
    "turn x 0.3": _turned(0.3),
    "turn x 0.6": _turned(0.6),
    "turn x 1.25": _turned(1.25),
    "turn x 3": _turned(3.0),
    "turn x -1": _turned(-1.0),
    "bias 0.1 rad/m": _biased(0.1),
    "bias 0.3 rad/m": _biased(0.3),
    "slips 1 s": Fault(apply=lambda log: odometry_faults.slipping(log, duration_s=1.0)),
    "slips 10 s": Fault(apply=lambda log: odometry_faults.slipping(log, duration_s=10.0)),
    "slips turning 5 s": Fault(
        apply=lambda log: odometry_faults.slipping(log, forward_m_s=0.0, turn_rad_s=0.5, duration_s=5.0)
    ),
    "stands still 10 s": Fault(apply=odometry_faults.standing_still),
    "jumps 1 m": Fault(apply=lambda log: odometry_faults.jumping(log, 1.0)),
    "jumps 5 m": Fault(apply=lambda log: odometry_faults.jumping(log, 5.0)),
    "2 m spikes": Fault(apply=lambda log: odometry_faults.spiking(log, 2.0)),
    "2 m leaps": Fault(apply=lambda log: odometry_faults.leaping(log, 2.0)),
    "held 2 scans": Fault(apply=odometry_faults.held),
    "wrong direction at times": Fault(apply=odometry_faults.unsigned),
    "dead from the middle": Fault(apply=odometry_faults.dead),
    "never moves": Fault(apply=lambda log: odometry_faults.dead(log, from_share=0.0)),
}
