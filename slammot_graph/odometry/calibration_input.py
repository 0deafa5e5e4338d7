"""What the calibration needs of a run: the odometry and the matches of its steps, cut into windows."""

from collections.abc import Iterable

import numpy as np

from slammot_graph.core.errors import InputError
from slammot_graph.core.results import StepResult
from slammot_graph.odometry.self_calibration import Windows, cut_windows


def windows_of_steps(steps: Iterable[StepResult]) -> Windows:
    """Cut a run into windows, see `cut_windows`; a scan whose match did not converge ends none.

    Parameters
    ----------
    steps : iterable of StepResult
        At least one, of a method that matches onto a local map.

    Raises
    ------
    InputError
        A scan has no odometry.
    """
    T_odom_base, T_anchor_base, cov_independent, cov_correlated, anchors, is_usable = [], [], [], [], [], []
    for step in steps:
        match = step.match
        converged = match if match is not None and match.status == "converged" else None
        if step.scan.T_odom_base is None:
            raise InputError(f"scan {step.scan.index} has no odometry to calibrate")
        T_odom_base.append(step.scan.T_odom_base)
        anchors.append(step.anchor_scan)
        is_usable.append(converged is not None)
        T_anchor_base.append(step.T_anchor_base if converged is None else converged.T_ref_base)
        cov_correlated.append(np.zeros((3, 3)) if converged is None else converged.cov_correlated)
        cov_independent.append(np.eye(3) if converged is None else converged.cov - converged.cov_correlated)
    return cut_windows(
        np.array(T_odom_base),
        np.array(T_anchor_base),
        np.array(cov_independent),
        np.array(cov_correlated),
        np.array(anchors),
        np.array(is_usable),
    )
