"""The command that estimates settings from a log: `calibrate`."""

from collections.abc import Callable, Iterator
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
from slammot_graph.cli.files import prepare_file
from slammot_graph.cli.reading import DEFAULT_READING, Reading
from slammot_graph.core.errors import InputError

if TYPE_CHECKING:
    from slammot_graph.core.results import StepResult
    from slammot_graph.logs import LaserLog
    from slammot_graph.odometry.noise import OdometryNoise
    from slammot_graph.odometry.self_calibration import Calibration, Windows
    from slammot_graph.pipeline_config import PipelineConfig
    from slammot_graph.run import Run


def calibrate_command(
    log: Annotated[Path, tyro.conf.arg(metavar="LOG")],
    /,
    *,
    output: Annotated[Path | None, tyro.conf.arg(metavar="FILE.toml")] = None,
    method: Annotated[str, tyro.conf.arg(metavar="NAME")] = "graph",
    max_scans: Annotated[int | None, tyro.conf.arg(metavar="K")] = None,
    reading: Reading = DEFAULT_READING,
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
    reading
        What of the log is read, and how.
    """
    from slammot_graph.core.config import to_toml
    from slammot_graph.logs import source_of
    from slammot_graph.odometry.self_calibration import calibrate
    from slammot_graph.run_folder.atomic import atomic_path

    check_max_scans(max_scans)
    config, default = _settings(method)
    opened = reading.open(log)
    if source_of(opened).get("odometry") is not None:
        raise InputError(f"{log}: no odometry, so there is none to calibrate")
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
        f"normalised squared residuals, 1 if consistent: {number(calibration.spread_before, 2)} before,"
        f" {number(calibration.spread, 2)} after"
    )
    if output is not None:
        text = f"# slammot-graph run LOG --output DIR --method {method} --config FILE.toml\n"
        text += f"# odometry_noise by slammot-graph calibrate {log.name!a}\n"
        with atomic_path(output) as path:
            path.write_text(text + to_toml(replace(config, odometry_noise=calibration.noise)), "utf-8")
        out.print(f"settings: {output}", soft_wrap=True)
    return EXIT_OK


def _settings(method: str) -> "tuple[PipelineConfig, OdometryNoise]":
    """Give the method's configuration and the noise that it has now."""
    from slammot_graph.methods import get_method
    from slammot_graph.odometry.noise import OdometryNoise
    from slammot_graph.pipeline_config import PipelineConfig

    config = get_method(method).config
    if not isinstance(config, PipelineConfig) or not config.has_graph:
        raise InputError(f"--method {method} does not match onto a local map; take graph")
    noise = config.odometry_noise
    return config, noise if isinstance(noise, OdometryNoise) else OdometryNoise()


def _run(log: "LaserLog", method: str, config: "PipelineConfig", max_scans: int | None) -> "Windows":
    """Run the method, without loop closure, and cut the log into windows."""
    from slammot_graph.core.config import from_plain
    from slammot_graph.odometry.calibration_input import windows_of_steps
    from slammot_graph.run import Run

    run = Run(
        log, method, config=from_plain({"localizer": {"close_loops": False}}, config), max_scans=max_scans
    )
    with scan_progress(log, method, max_scans) as show:
        return windows_of_steps(_counted(run, show))


def _counted(run: "Run", show: Callable[[int], None]) -> "Iterator[StepResult]":
    """The steps of a run, each of them shown as progress."""
    for n_scans, step in enumerate(run, start=1):
        yield step
        show(n_scans)


def _warn_of_motion(log: Path, calibration: "Calibration") -> None:
    """Name in one line the parameters that the log does not determine."""
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
