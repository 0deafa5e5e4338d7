# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # The paper, step by step
#
# A robot drives through a room with a 2D laser while people walk about. The paper's method, DOCPFO-ICP (here:
# `docpfo`), decides for each laser point whether it hit something that moves, leaves those points out of the scan
# matching, and so gets a pose, a map and the people at once. This notebook goes through its parts with a simulated
# walk, where the truth is known.

# %%
import sys
from itertools import pairwise

import matplotlib.pyplot as plt
import numpy as np

from slammot_graph import PipelineConfig, Run, get_method
from slammot_graph.core import se2
from slammot_graph.detection.ellipse_detector import EllipseDetectorConfig
from slammot_graph.detection.ellipse_test import detect_moving, end_point_covariances
from slammot_graph.detection.reasons import REASONS
from slammot_graph.evaluation import absolute_error, evaluate_points, pose_errors, relative_error
from slammot_graph.localization.config import ScanToScanConfig
from slammot_graph.mapping.occupancy_grid import OccupancyGrid
from slammot_graph.registration.point_to_point import match_scans
from slammot_graph.simulation import simulate

sys.path += ["..", "."]  # the project's root, from here or as the working folder
from experiments.figures import COLORS, SIGMAS_95, draw_ellipses, draw_map, view_of
from experiments.ladder import presets
from experiments.paper import draw_map_panel, draw_walker_panel, shown

config = get_method("docpfo").config
assert isinstance(config, PipelineConfig)
localizer, detector = config.localizer, config.detector
assert isinstance(localizer, ScanToScanConfig)
assert isinstance(detector, EllipseDetectorConfig)
log = simulate("two-walkers", seed=0, noise_scale=3.0)  # wheels that need repair, as the paper's do
scans = list(log)
shown_scan = 111  # the one to look at closely
print(
    f"{log.n_scans} scans of {log.laser.n_beams} beams; {log.is_moving.mean():.1%} of the beams hit a person"
)

# %% [markdown]
# ## Two sources of doubt: R_r and R_l
#
# A laser point in the map is uncertain for two reasons. The robot does not know exactly where it is: that is R_r, the
# covariance of its pose. And the beam itself has noise in range and angle: that is R_l. The paper adds the two, each
# propagated to the end point by its Jacobian (eq. 9):
#
# $$R_p = H_r R_r H_r^T + H_l R_l H_l^T$$
#
# The figure shows how large the 95% ellipse of an end point is, over the range of the beam. R_r counts far more than
# R_l, and its angle makes the ellipse grow with the range: 0.05 rad is half a metre at 10 m.

# %%
assert not isinstance(detector.test_covariance, str)
R_r = detector.test_covariance.covariance(se2.IDENTITY)
scan = scans[shown_scan]
is_valid = scan.is_valid(config.max_range_m)
T_world_base = log.T_world_base[shown_scan]
both = end_point_covariances(scan, T_world_base, R_r, detector.ellipse_test)
beam_only = end_point_covariances(scan, T_world_base, np.zeros((3, 3)), detector.ellipse_test)

figure, axes = plt.subplots(figsize=(6, 3.4), layout="constrained")
for cov, name in ((both, "R_r and R_l"), (beam_only, "R_l alone")):
    longest = SIGMAS_95 * np.sqrt(np.linalg.eigvalsh(cov[is_valid])[:, -1])
    axes.plot(scan.ranges[is_valid], longest, ".", label=name)
axes.set(xlabel="range of the beam [m]", ylabel="long half axis, 95% ellipse [m]", ylim=(0, None))
axes.legend()
plt.show()

# %% [markdown]
# ## A grid with three states
#
# Each cell of the map holds a probability of being occupied. A beam that crosses a cell lowers it, a beam that ends
# there raises it. Above 0.8 a cell is *occupied*, below 0.2 it is *free*, and between it is *unknown*. A cell nobody
# has looked at is unknown too.
#
# So it takes several looks before a cell says anything. Left: one cell, looked at again and again. Right: the map
# after the first scans, drawn at the true poses (black occupied, white free, grey unknown).

# %%
grid = OccupancyGrid(config.grid)
looks = np.arange(8)
figure, axes = plt.subplots(1, 3, figsize=(11, 3.4), layout="constrained")
for log_odds, name in ((grid.l_hit, "beams end in it"), (grid.l_pass, "beams cross it")):
    axes[0].plot(looks, 1 / (1 + np.exp(-log_odds * looks)), "o-", label=name)
axes[0].axhspan(config.grid.p_free, config.grid.p_occupied, color="0.9", label="unknown")
axes[0].set(xlabel="number of beams", ylabel="probability of being occupied", ylim=(0, 1))
axes[0].legend()

n_drawn = 0
for panel, n_scans in zip(axes[1:], (2, shown_scan), strict=True):
    for earlier in scans[n_drawn:n_scans]:
        ends = earlier.points(log.T_world_base[earlier.index])
        laser = se2.transform(log.T_world_base[earlier.index], earlier.laser.origin_base[None])[0]
        valid = earlier.is_valid(config.max_range_m)
        grid.update(earlier.index, laser, ends, valid, valid)  # the paper's map takes all points
    n_drawn = n_scans
    draw_map(panel, grid.to_map(), view_of(scan.points(T_world_base)[is_valid]))
    panel.set(title=f"after {n_scans} scans", xlabel="x [m]", ylabel="y [m]")
plt.show()

# %% [markdown]
# ## The test
#
# A point moves if its ellipse lies on free cells only: something is there now, where nothing was before. If the
# ellipse touches an occupied cell the point may just be the wall, and if it touches an unknown one nobody knows. Both
# count as static.
#
# The points that pass are grouped by distance. A group with too few points (MINNUMBER) or too wide for a person
# (MAX X RANGE, MAX Y RANGE) is discarded.
#
# Here the test runs on one scan, at the true pose, on the map drawn above. Rings mark the beams that truly hit a
# person.

# %%
found = detect_moving(scan, is_valid, T_world_base, R_r, grid, detector.ellipse_test, detector.clusters)
points = scan.points(T_world_base)

figure, axes = plt.subplots(figsize=(8, 5), layout="constrained")
draw_map(axes, grid.to_map(), view_of(points[is_valid]))
for reason in np.unique(found.reason[is_valid]):
    axes.plot(*points[found.reason == reason].T, ".", label=REASONS[reason])
axes.plot(
    *points[log.is_moving[shown_scan]].T,
    "o",
    color="k",
    markersize=11,
    fillstyle="none",
    label="truly a person",
)
axes.plot(*T_world_base[:2], "^", color=COLORS["truth"], markersize=9, label="robot")
axes.set(title=f"scan {shown_scan}", xlabel="x [m]", ylabel="y [m]")
figure.legend(loc="outside lower center", fontsize=8, ncols=2)
plt.show()

# %% [markdown]
# ## The ellipses of a whole run
#
# `shown` runs a method over the log and keeps one step of it. This is the paper's Fig. 3: end points with their
# ellipses on the map, blue ones static, red ones moving. Any ellipse that reaches a wall makes its point static,
# whatever it hit. The map is that of the whole run, with the errors that `docpfo` made.

# %%
at_share = (shown_scan + 0.5) / (log.n_scans - 1)
runs = {method: shown(log, method, at_share) for method in ("icp", "docpfo", "graph")}
run = runs["docpfo"]
T_map_base = run.step.T_map_base
figure, axes = plt.subplots(figsize=(7, 4.6), layout="constrained")
draw_map(axes, run.result.grid, view_of(run.step.scan.points(T_map_base)[run.step.is_valid], 0.8))
draw_ellipses(axes, run.step, T_map_base)
axes.set(title=f"docpfo, scan {run.step.scan.index}", xlabel="x [m]", ylabel="y [m]")
plt.show()

# %% [markdown]
# ## Matching with and without the people
#
# The paper matches a scan onto the one before: pair each point with its nearest, find the motion that brings the
# pairs together, repeat (eq. 3 to 5). People who moved between the two scans pull the result along.
#
# How far apart are the two? The beams of two scans hardly ever hit the same places, which biases each match a little,
# so ten matches a second add ten times as much as one. The paper's own R_r is the error of the odometry after a step of
# some decimetres. Here a cycle of match and map runs once the robot has moved by a step, the odometry carries the
# pose in between, and a point's partner is the nearest place on the line between two points of the earlier scan
# (Lu and Milios 1997). What the paper leaves open was searched: `experiments/tables/paper_search.md`.
#
# To see only the people, the next figure takes the filter out of the question: it matches scans half a second apart
# twice, once with all points and once without those that *truly* hit a person, and compares each match with the true
# motion.

# %%
errors_m: dict[str, list[float]] = {"all points": [], "without people (true labels)": []}
for before, after in pairwise(scans[::5]):
    start = se2.between(log.T_odom_base[before.index], log.T_odom_base[after.index])
    motion = se2.between(log.T_world_base[before.index], log.T_world_base[after.index])
    for name, values in errors_m.items():
        use = [s.is_valid() for s in (before, after)]
        if name != "all points":
            use = [mask & ~log.is_moving[s.index] for mask, s in zip(use, (before, after), strict=True)]
        match = match_scans(
            before.points_base(), use[0], after.points_base(), use[1], start, localizer.point_to_point
        )
        values.append(np.hypot(*pose_errors(match.T_ref_base[None], motion[None])[0, :2]))

figure, axes = plt.subplots(figsize=(6, 3.4), layout="constrained")
for name, values in errors_m.items():
    axes.ecdf(1000 * np.array(values), label=name)
axes.set(xlabel="error of the motion between two scans [mm]", ylabel="share of the pairs below it")
axes.legend(loc="lower right")
plt.show()

# %% [markdown]
# ## The whole drive
#
# The paper's figures 1 and 7: map and trajectory. `icp` is the matching without the filter, `docpfo` with it, and
# `graph` is this package's method. The error in the titles is over pairs of poses one metre apart.

# %%
figure, axes = plt.subplots(1, 3, figsize=(12, 4), layout="constrained")
for panel, (method, run) in zip(axes, runs.items(), strict=True):
    local = relative_error(run.result.T_map_base, log.T_world_base, delta=1.0, unit="m").translation_m.rmse
    draw_map_panel(panel, run, f"{method}: {1000 * local:.0f} mm over 1 m")
    panel.set(xlabel="x [m]", ylabel="y [m]")
axes[-1].legend(fontsize=8, loc="lower right")
plt.show()

# %% [markdown]
# And its Fig. 8, where the walkers were: green dots are the truth, red ones what the method found (`icp` looks for
# nobody). The share of the beams on people that were found is in the titles; for `graph` it is that of its final
# labels, which look back from the end of the run.

# %%
figure, axes = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
for panel, method in zip(axes, ("docpfo", "graph"), strict=True):
    run = runs[method]
    recall = evaluate_points(run.result.is_moving, log.is_moving, run.result.is_valid).recall
    draw_walker_panel(panel, run, log, f"{method}: {recall:.1%} of the beams on people found")
    panel.set(xlabel="x [m]", ylabel="y [m]")
axes[-1].legend(fontsize=8, loc="lower right")
plt.show()

# %% [markdown]
# ## From the paper to `graph`, one change a preset
#
# Each preset below changes one thing of the one above it, and is nothing but a configuration. The same log, run by
# each: the error of the trajectory, and how many of the beams called moving or truly on people are both.

# %%
errors_mm, ious = [], []
for preset in presets():
    result = Run(log, config=preset.config).complete()
    errors_mm.append(1000 * absolute_error(result.T_map_base, log.T_world_base).translation_m.rmse)
    ious.append(evaluate_points(result.is_moving, log.is_moving, result.is_valid).iou)
    print(f"{preset.name:20} {errors_mm[-1]:6.1f} mm   IoU {ious[-1]:.2f}   {preset.change}")

figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), sharey=True, layout="constrained")
names = [preset.name for preset in presets()]
for panel, values, label in zip(axes, (errors_mm, ious), ("ATE [mm]", "IoU of moving points"), strict=True):
    panel.barh(names, values, color=COLORS["estimate"])
    panel.set_xlabel(label)
axes[0].invert_yaxis()
axes[0].set_xscale("log")
plt.show()

# %% [markdown]
# ## What limits the paper's method
#
# - **R_r is constant and large.** Its ellipses reach a wall from far away, so a person near one counts as static. From
#   one scan to the next, the odometry of this robot is much better than R_r says.
# - **The map takes all points.** People draw their own path into the map. Where one was seen, cells are no longer free,
#   and who walks there counts as static until enough beams have crossed them again.
# - **Matches of one scan onto one other add up their errors.** A local map of many scans, lines in place of points and
#   closed loops take most of that away.
#
# This is one simulated drive. Tables over 20 of them are in `experiments/tables` (`ladder.md`, `paper_claim.md`), and
# notebook 4 shows how to read them.
