"""The command that learns settings from a log: `calibrate`."""

import itertools
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.table import Table

from slammot_graph.cli.console import (
    EXIT_OK,
    check_max_scans,
    figure_table,
    number,
    scan_progress,
    stderr,
    stdout,
    warn,
)
from slammot_graph.cli.files import LaserPose, prepare_file, whole_file
from slammot_graph.core.errors import InputError

if TYPE_CHECKING:
    from slammot_graph.logs import LaserLog
    from slammot_graph.odometry.noise import OdometryNoise
    from slammot_graph.odometry.self_calibration import Calibration, Windows
    from slammot_graph.pipeline import PipelineConfig


def calibrate_command(
    log: Annotated[Path, tyro.conf.arg(metavar="LOG")],
    /,
    *,
    output: Annotated[Path | None, tyro.conf.arg(metavar="FILE.toml")] = None,
    method: Annotated[str, tyro.conf.arg(metavar="NAME")] = "graph",
    max_scans: Annotated[int | None, tyro.conf.arg(metavar="K")] = None,
    scan_topic: Annotated[str | None, tyro.conf.arg(metavar="T")] = None,
    odom_topic: Annotated[str | None, tyro.conf.arg(metavar="T")] = None,
    laser_pose: LaserPose = None,
) -> int:
    """Estimate the odometry's noise from a log, for `run --config`.

    Parameters
    ----------
    log
        As for `slammot-graph run`; the robot should drive and turn in it.
    output
        Settings of the method with the estimated noise, to be written; without it they are only shown.
    method
        One of those that `slammot-graph methods` lists and that match onto a local map.
    max_scans
        Take the log's first ones only.
    scan_topic
        Which laser of a bag.
    odom_topic
        Which odometry of a bag.
    laser_pose
        As for `slammot-graph run`.
    """
    from slammot_graph.core.config import to_toml
    from slammot_graph.logs import open_log
    from slammot_graph.odometry.self_calibration import calibrate

    check_max_scans(max_scans)
    config, default = _settings(method)
    opened = open_log(log, scan_topic=scan_topic, odom_topic=odom_topic, laser_pose=laser_pose)
    if output is not None:
        if output.exists() and output.samefile(log):
            raise InputError(f"{output}: is the log itself; name another --output")
        prepare_file(output)
    windows = _run(opened, method, config, max_scans)
    warn(opened)
    try:
        calibration = calibrate(windows, default)
    except InputError as error:
        raise InputError(f"{log}: {error}; calibrate on a log in which the robot drives") from None
    _warn_of_motion(log, calibration)
    out = stdout()
    out.print(_table(log, default, calibration))
    out.print(
        f"normalised squared residuals, 1 if honest: {number(calibration.spread_before, 2)} before,"
        f" {number(calibration.spread, 2)} after"
    )
    if output is not None:
        text = f"# slammot-graph run LOG --output DIR --method {method} --config FILE.toml\n"
        text += f"# odometry_noise by slammot-graph calibrate {log.name!a}\n"
        with whole_file(output) as path:
            path.write_text(text + to_toml(replace(config, odometry_noise=calibration.noise)), "utf-8")
        out.print(f"settings: {output}", soft_wrap=True)
    return EXIT_OK


def _settings(method: str) -> "tuple[PipelineConfig, OdometryNoise]":
    """Give the method's configuration and the noise that it has now."""
    from slammot_graph.methods import get_method
    from slammot_graph.odometry.noise import OdometryNoise
    from slammot_graph.pipeline import PipelineConfig

    config = get_method(method).config
    if not isinstance(config, PipelineConfig) or not config.has_graph:
        raise InputError(f"--method {method} does not match onto a local map; take graph")
    noise = config.odometry_noise
    return config, noise if isinstance(noise, OdometryNoise) else OdometryNoise()


def _run(log: "LaserLog", method: str, config: "PipelineConfig", max_scans: int | None) -> "Windows":
    """Run the method, without loop closure, and cut the log into windows."""
    import numpy as np

    from slammot_graph.core.config import from_plain
    from slammot_graph.odometry.self_calibration import cut_windows
    from slammot_graph.pipeline import Pipeline

    pipeline = Pipeline(from_plain({"localizer": {"close_loops": False}}, config))
    T_odom_base, T_anchor_base, cov_independent, cov_correlated, anchors, is_usable = [], [], [], [], [], []
    try:
        with scan_progress(log, method, max_scans) as show:
            for n_scans, scan in enumerate(itertools.islice(log, max_scans), start=1):
                step = pipeline.step(scan)
                match = step.match
                converged = match if match is not None and match.status == "converged" else None
                T_odom_base.append(scan.T_odom_base)
                anchors.append(step.anchor_scan)
                is_usable.append(converged is not None)
                T_anchor_base.append(step.T_anchor_base if converged is None else converged.T_ref_base)
                cov_correlated.append(np.zeros((3, 3)) if converged is None else converged.cov_correlated)
                cov_independent.append(
                    np.eye(3) if converged is None else converged.cov - converged.cov_correlated
                )
                show(n_scans)
    finally:
        pipeline.close()
    if not anchors:
        reasons = "; ".join(f"{skipped.place}: {skipped.reason}" for skipped in log.skipped[:3])
        raise InputError(f"{log.path}: none of its {log.n_scans} scans is usable ({reasons})")
    return cut_windows(
        np.array(T_odom_base),
        np.array(T_anchor_base),
        np.array(cov_independent),
        np.array(cov_correlated),
        np.array(anchors),
        np.array(is_usable),
    )


def _warn_of_motion(log: Path, calibration: "Calibration") -> None:
    """Say in one line what the log could not tell."""
    if calibration.kept:
        stderr().print(
            f"warning: {log}: too little motion, {calibration.distance_m:.1f} m driven and"
            f" {calibration.turn_rad:.1f} rad turned; kept as they are: {', '.join(calibration.kept)}",
            soft_wrap=True,
        )


def _table(log: Path, default: "OdometryNoise", calibration: "Calibration") -> Table:
    from slammot_graph.odometry.self_calibration import PARAMETERS

    title = (
        f"Odometry noise of {log.name}, from {calibration.n_windows} windows over"
        f" {calibration.distance_m:.1f} m and {calibration.turn_rad:.1f} rad"
    )
    table = figure_table(title, "parameter", "default", "estimated", "windows", no_wrap=True)
    for name, n_windows in zip(PARAMETERS, calibration.n_windows_of, strict=True):
        estimated = "kept" if name in calibration.kept else number(getattr(calibration.noise, name), 4)
        table.add_row(name, number(getattr(default, name), 4), estimated, str(n_windows))
    return table
