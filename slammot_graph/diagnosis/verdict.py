"""The verdict on a run: what is wrong, its likely cause, and the remedy."""

import math
import re
from collections.abc import Sequence

from slammot_graph.core.findings import Finding, FindingKind, worst_first
from slammot_graph.core.odometry_report import Estimated, OdometryReport
from slammot_graph.core.results import GridMap
from slammot_graph.diagnosis.inspect import N_FIRST_SCANS
from slammot_graph.diagnosis.odometry import n_times
from slammot_graph.diagnosis.statistics import RunStatistics

N_SIGMA = 3.0
"""A number is off where it is by so many of its standard deviations, and by the least that matters:"""

LEAST_SCALE, LEAST_SCALE_TOLD = 0.05, 0.03
"""A scale of distances from the second on is worth a word: nothing says whose metre is right, and the map has one."""
LEAST_BIAS_RAD_PER_M = 0.04
LEAST_OFFSET_S = 0.03
LEAST_DIRECTION_RAD = math.radians(5.0)
LEAST_SHIFT_M = 0.1
LARGEST_TRUSTED_STD = 0.3
"""A sign or a direction is told by an estimate that is sharper than this."""

NOISY = 3.0
"""An odometry this many times as noisy as its noise model is worth a word."""

MANY_FAILED = 0.2

MEASURED_LATE = "the run has corrected for it"

_OF_WARNINGS: Sequence[tuple[FindingKind, str]] = (
    ("frames", r"two (frames|lasers)|frames of|other frame"),
    ("beam times", r"time_increment"),
    ("no-return value", r"for no return"),
    ("stamps", r"(all|equal|same|identical) stamps|stamps? (are|is|never|do|does)\b|wrap"),
    ("no odometry", r"without odometry|laser alone|no odometry"),
    ("odometry never moves", r"static transform|never (moves|changes)"),
)
"""Warnings of a log that its verdict repeats."""


def diagnose(
    statistics: RunStatistics, report: OdometryReport, log_warnings: Sequence[str] = ()
) -> tuple[Finding, ...]:
    """Give what is wrong, the worst first; empty where nothing is.

    Parameters
    ----------
    statistics : RunStatistics
        Of all scans.
    report : OdometryReport
        Calibration of the odometry against the matches.
    log_warnings : sequence of str
        Of the log; those about stamps, frames and odometry are repeated.
    """
    scans = statistics.scans
    found = scans.findings()
    is_blind = any(finding.severity == "error" for finding in found)
    found += statistics.odometry.findings(has_moved=scans.has_moved and not is_blind)
    kinds = {finding.kind for finding in found}
    if report.has_odometry and not is_blind and not kinds & {"no odometry", "odometry never moves"}:
        of_report = _of_report(report, is_held="odometry leaps" in kinds)
        found += [finding for finding in of_report if finding.kind not in kinds]
    if not is_blind:
        # where it never moves, that is the contradiction
        may_contradict = report.has_odometry and "odometry never moves" not in kinds
        found += _of_matches(statistics, may_contradict=may_contradict)
        found += statistics.turns.findings()
        found += statistics.come_up.findings()
        found += statistics.consistency.findings()
    found += _of_blindness(statistics.blind)
    found += _of_warnings(log_warnings, {finding.kind for finding in found})
    return worst_first(found)


def findings_of_map(grid: GridMap, resolution_m: float) -> list[Finding]:
    """Say that the map has larger cells than asked for, as it would have too many."""
    if grid.resolution_m <= 1.01 * resolution_m:
        return []
    rows, columns = grid.p_occupied.shape
    height_m, width_m = grid.resolution_m * rows, grid.resolution_m * columns
    return [
        Finding(
            kind="map resolution",
            severity="info",
            cause=(
                f"what was seen spans {width_m:.0f} x {height_m:.0f} m, too much for one picture of cells of"
                f" {resolution_m:g} m: the map has cells of {grid.resolution_m:g} m"
            ),
            remedy="",
            data={"resolution_m": grid.resolution_m, "width_m": width_m, "height_m": height_m},
        )
    ]


def _of_blindness(blind: Sequence[tuple[int, str]]) -> list[Finding]:
    """Where the laser told nothing."""
    found: list[Finding] = []
    for cause, what, remedy in (
        (
            "repeated",
            "the laser gave the same scan again while the robot moved",
            "look at its driver and its cable",
        ),
        ("covered", "something covered the laser", "look at what was before it"),
        ("partly covered", "something covered most beams of the laser", "look at what was before it"),
    ):
        scans = [scan for scan, told in blind if told == cause]
        left = "what the others see" if cause == "partly covered" else "the odometry alone"
        if scans:
            found.append(
                Finding(
                    kind="laser blind",
                    severity="warning",
                    cause=(
                        f"{what} ({n_times(len(scans))}, first at scan {scans[0]}): {left} tells of the way"
                    ),
                    remedy=remedy,
                    data={"cause": cause, "n_times": len(scans), "first": scans[0]},
                )
            )
    return found


def _of_matches(statistics: RunStatistics, *, may_contradict: bool) -> list[Finding]:
    """What became of the matches."""
    matches, n = statistics.matches, statistics.scans.n_scans
    n_failed, n_matched = matches["failed"], matches["converged"] + matches["degenerate"]
    found: list[Finding] = []
    # kiss-icp tells of no match, and is never degenerate
    makes_matches = statistics.limits.makes_matches and (
        matches["none"] < n or statistics.health["degenerate"] > 0
    )
    if makes_matches and n > N_FIRST_SCANS and n_matched == 0:
        found.append(
            Finding(
                kind="nothing matched",
                severity="error",
                cause=f"nothing could be matched in {n} scans",
                remedy="look at the laser's pose, its angles and the units of its ranges",
                data={"n_scans": n},
            )
        )
    elif n_failed > MANY_FAILED * n:
        found.append(
            Finding(
                kind="many failed matches",
                severity="warning",
                cause=f"{n_failed} of {n} matches failed",
                remedy="look at the laser's pose, at --max-range, and at what the odometry is said to do wrong",
                data={"n_failed": n_failed, "n_scans": n},
            )
        )
    if statistics.n_lost:
        times, n_apart = n_times(statistics.n_lost), statistics.n_apart
        apart = (
            f"has not been found again {n_times(n_apart)}: where what it saw there lies in the map is not known"
            if n_apart
            else "found again; the map before and after hangs together where a loop closed"
        )
        found.append(
            Finding(
                kind="lost",
                severity="warning",
                cause=f"the robot was lost {times}, and {apart}",
                remedy="look at the events where it was lost, and drive back to known places that look like no others",
                data={"n_lost": statistics.n_lost, "n_apart": n_apart},
            )
        )
    if statistics.contradictions and may_contradict:
        n_times_begun, n_scans = len(statistics.contradictions), statistics.health["contradiction"]
        found.append(
            Finding(
                kind="contradiction",
                severity="warning",
                cause=(
                    f"odometry and laser contradict each other {n_times(n_times_begun)}, in {n_scans}"
                    f" scans, first at scan {statistics.contradictions[0]}: wheels slip, the odometry jumps, or"
                    " people walk along"
                ),
                remedy="look at these scans (health in summary.json); their poses are less certain",
                data={"n_contradictions": n_times_begun, "n_scans": n_scans},
            )
        )
    return found


def _of_report(report: OdometryReport, *, is_held: bool) -> list[Finding]:
    """What the calibration found; odometry that is held for scans is late by that, and its scales tell nothing."""
    if is_held:
        return []
    return [
        finding
        for finding in (
            _heading(report.heading_scale),
            _bias(report.heading_bias_rad_per_m),
            _distance(report.distance_scale),
            _direction(report.direction_rad),
            _shift(report.laser_shift_x_m, report.laser_shift_y_m),
            _clock(report.clock_offset_s),
            _noise(report.noise_scale_m, report.noise_scale_rad),
        )
        if finding is not None
    ]


def _is_off(estimated: Estimated, nominal: float, least: float) -> bool:
    """Whether a number is known well enough to differ from the nominal one by more than the least that matters."""
    off = abs(estimated.value - nominal)
    return math.isfinite(estimated.std) and off > least and off > N_SIGMA * estimated.std


def _is_negative(estimated: Estimated) -> bool:
    return math.isfinite(estimated.std) and estimated.value < -max(0.2, N_SIGMA * estimated.std)


def _data(estimated: Estimated) -> dict[str, float]:
    return {"value": estimated.value, "std": estimated.std}


def _times(scale: float) -> str:
    """Say what odometry with this scale (true over told) does wrong."""
    return f"{1.0 / scale:.3g} times too long" if scale < 1.0 else f"{scale:.3g} times too short"


def _heading(scale: Estimated) -> Finding | None:
    if _is_negative(scale):
        return Finding(
            kind="odometry turns the wrong way",
            severity="warning",
            cause=(
                "the odometry contradicts the laser: it turns the opposite way (wrong sign, heading scale"
                f" {scale.value:.2f} +- {scale.std:.2g}), or the laser is mounted upside down"
            ),
            remedy="mend the sign of the odometry's heading, or the laser's pose; or run with --odometry off",
            data=_data(scale),
        )
    if not _is_off(scale, 1.0, LEAST_SCALE):
        return None
    told = f"true turns are {scale.value:.3g} +- {scale.std:.2g} times those of the odometry"
    return Finding(
        kind="heading scale",
        severity="warning",
        cause=f"heading scale {scale.value:.3g}: {told}, its wheel base is wrong",
        remedy=f"divide the wheel base by {scale.value:.3g}; {MEASURED_LATE}"
        if scale.value > 0.0
        else MEASURED_LATE,
        data=_data(scale),
    )


def _bias(bias: Estimated) -> Finding | None:
    if not _is_off(bias, 0.0, LEAST_BIAS_RAD_PER_M):
        return None
    degrees = math.degrees(bias.value)
    return Finding(
        kind="heading bias",
        severity="warning",
        cause=(
            f"heading bias {degrees:+.2g} +- {math.degrees(bias.std):.1g} degrees per metre: the robot turns where the"
            " odometry tells of driving straight ahead, one wheel is larger than the other"
        ),
        remedy=f"calibrate the radii of both wheels; {MEASURED_LATE}",
        data=_data(bias),
    )


def _distance(scale: Estimated) -> Finding | None:
    if not _is_off(scale, 1.0, LEAST_SCALE_TOLD):
        return None
    return Finding(
        kind="distance scale",
        severity="warning" if _is_off(scale, 1.0, LEAST_SCALE) else "info",
        cause=(
            f"distance scale {scale.value:.3g} +- {scale.std:.2g}: the odometry's distances are"
            f" {_times(scale.value)}, or else the laser's ranges {_times(1.0 / scale.value)}"
        ),
        remedy=(
            f"multiply the wheel radius, or counts to metres, by {scale.value:.3g}; {MEASURED_LATE}, for it takes the"
            " laser's ranges for right: if they are not, the map and the path have the wrong size"
        ),
        data=_data(scale),
    )


def _direction(direction_rad: Estimated) -> Finding | None:
    if not math.isfinite(direction_rad.value) or not direction_rad.std <= LARGEST_TRUSTED_STD:
        return None
    off = math.remainder(direction_rad.value, math.tau)
    if abs(off) > math.radians(150.0):
        return Finding(
            kind="mounting turned",
            severity="warning",
            cause=(
                "the laser's mounting looks turned by 180 degrees, or the odometry drives the wrong way: the laser"
                " moves backward where the odometry drives forward"
                f" ({math.degrees(off):.0f} +- {math.degrees(direction_rad.std):.2g} degrees)"
            ),
            remedy="give --laser-pose with the yaw turned by pi, or mend the sign of the odometry's distance",
            data=_data(direction_rad),
        )
    if not _is_off(Estimated(value=off, std=direction_rad.std), 0.0, LEAST_DIRECTION_RAD):
        return None
    degrees = math.degrees(off)
    return Finding(
        kind="mounting turned",
        severity="warning",
        cause=(
            f"the laser's mounting looks turned by {degrees:.1f} +- {math.degrees(direction_rad.std):.2g} degrees"
            " against the direction in which the robot drives"
        ),
        remedy=f"give --laser-pose with a yaw that is {off:+.3f} rad less; {MEASURED_LATE}",
        data=_data(direction_rad),
    )


def _shift(x_m: Estimated, y_m: Estimated) -> Finding | None:
    """Where the laser sits, by its swing in turns."""
    off = [
        (name, shift, ahead if shift.value > 0.0 else behind)
        for name, shift, ahead, behind in (("x", x_m, "forward", "back"), ("y", y_m, "left", "right"))
        if _is_off(shift, 0.0, LEAST_SHIFT_M)
    ]
    if not off:
        return None
    where = [f"{abs(shift.value):.2f} +- {shift.std:.1g} m farther {to}" for _, shift, to in off]
    more = [f"{name} {shift.value:+.2f} m" for name, shift, _ in off]
    return Finding(
        kind="mounting shifted",
        severity="warning",
        cause=(
            f"in turns the laser swings as if it sat {' and '.join(where)} than its pose says: that pose is wrong,"
            " or the robot turns about another point than the one whose path the odometry tells"
        ),
        remedy=(
            f"give --laser-pose with {' and '.join(more)} more; until then the path is that of the point which the"
            " given pose makes the base, off the true one by so much"
        ),
        data={f"{name}_m": shift.value for name, shift, _ in off},
    )


def _clock(offset_s: Estimated) -> Finding | None:
    if not abs(offset_s.value) > LEAST_OFFSET_S:  # none but a clear one is believed
        return None
    lags = "lags behind" if offset_s.value < 0.0 else "is ahead of"
    return Finding(
        kind="clock offset",
        severity="warning",
        cause=(
            f"the clocks differ: the laser's {lags} the odometry's by {abs(offset_s.value):.3f}"
            f" +- {offset_s.std:.2g} s"
        ),
        remedy=f"stamp scans when they are taken, and synchronise the clocks; {MEASURED_LATE}",
        data=_data(offset_s),
    )


def _noise(scale_m: Estimated, scale_rad: Estimated) -> Finding | None:
    is_noisy = [_is_off(scale, 1.0, NOISY - 1.0) and scale.value > NOISY for scale in (scale_m, scale_rad)]
    if not any(is_noisy):
        return None
    return Finding(
        kind="odometry noise",
        severity="info",
        cause=(
            f"the odometry is noisier than its settings say: {scale_m.value:.2g} times in translation,"
            f" {scale_rad.value:.2g} times in rotation"
        ),
        remedy=f"slammot-graph calibrate estimates the settings; {MEASURED_LATE}",
        data={"noise_scale_m": scale_m.value, "noise_scale_rad": scale_rad.value},
    )


def _of_warnings(log_warnings: Sequence[str], told: set[FindingKind]) -> list[Finding]:
    """Repeat what the log warns of, unless the run has found it by itself."""
    found: list[Finding] = []
    for text in log_warnings:
        kind = next((kind for kind, words in _OF_WARNINGS if re.search(words, text, re.IGNORECASE)), None)
        if kind is not None and kind not in told:
            found.append(Finding(kind=kind, severity="warning", cause=text, remedy=""))
    return found
