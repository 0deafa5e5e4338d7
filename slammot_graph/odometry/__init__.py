"""How the robot moved between two scans: the noise of an increment, motion models, and the odometry's calibration.

A motion model gives each scan's increment with its covariance; `Propagation` carries a pose and its covariances along.
Imports `core` only.
"""

from slammot_graph.odometry.motion import Motion
from slammot_graph.odometry.noise import ConstantNoise, OdometryNoise
from slammot_graph.odometry.propagation import MotionModel, MotionState, Propagation, WheelOdometry

__all__ = [
    "ConstantNoise",
    "Motion",
    "MotionModel",
    "MotionState",
    "OdometryNoise",
    "Propagation",
    "WheelOdometry",
]
