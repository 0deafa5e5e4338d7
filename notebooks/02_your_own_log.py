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
# # Your own log
#
# From a log to a trajectory, a map, moving points and tracks, and how to read them back from the run folder. To be
# able to run anywhere, this notebook writes a small simulated log first; put your own in its place.

# %%
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

from slammot_graph import Run, load_run, open_log
from slammot_graph.simulation import simulate

sys.path += ["..", "."]  # the project's root, from here or as the working folder
from experiments.figures import draw_ellipses, draw_map, draw_path, view_of

temporary = TemporaryDirectory()
folder = Path(temporary.name)
log_path = folder / "log.npz"  # for your own: the path of a .log, .clf, .bag, .db3, .mcap or .npz file
simulate("lab", seed=1).write(log_path)

# %% [markdown]
# ## Run
#
# `open_log` tells the format by the file. A `Run` is iterated, scan by scan, and each step says what that scan brought.
# What is known only at the end, the optimised trajectory, the map and the final labels, is in `run.result()`.

# %%
log = open_log(log_path)
run = Run(log, method="graph")
steps = list(run)
result = run.result()
print(f"{log.n_scans} scans, {result.n_skipped} unusable; {len(result.nodes)} nodes in the graph")
print(
    f"{sum(edge.kind == 'closure' for edge in result.edges)} loop closures, {result.n_failed_matches} failed matches"
)

# %% [markdown]
# A step as it came: one scan on the map, points called moving in red, with the ellipses that the test used.

# %%
step = steps[250]
points = step.scan.points(result.T_map_base[250])[step.is_valid]
figure, axes = plt.subplots(figsize=(7, 4.2), layout="constrained")
draw_map(axes, result.grid, view_of(np.vstack([points, result.T_map_base[:, :2]])))
draw_ellipses(axes, step, result.T_map_base[250])
axes.set(title=f"scan 250, at {step.scan.stamp:.1f} s", xlabel="x [m]", ylabel="y [m]")
plt.show()

# %% [markdown]
# ## The run folder
#
# On the command line, `slammot-graph run LOG --output DIR` does all of this and leaves its files in `DIR`. From Python
# the folder is written by `result.save`. The recording for the rerun viewer, `run.rrd`, is made by the command
# only.

# %%
output = folder / "run"
result.save(output)
for path in sorted(output.iterdir()):
    print(f"{path.name:18} {path.stat().st_size / 1024:7.0f} kB")

# %% [markdown]
# `overview.png` shows the whole run.

# %%
picture = plt.imread(output / "overview.png")
figure, axes = plt.subplots(figsize=(8, 8 * picture.shape[0] / picture.shape[1]), layout="constrained")
axes.imshow(picture)
axes.axis("off")
plt.show()

# %% [markdown]
# ## Trajectory and map
#
# `load_run` reads the folder back. The trajectory, `trajectory.tum`, is a text file in the TUM format: the stamps and
# x, y, heading of the robot in the map. The map is a picture in the format of ROS map_server, whose first row is the
# top: black is occupied, white free, grey unknown. `map.yaml` tells the size of a cell and where the lower left corner
# lies.

# %%
saved = load_run(output)
stamps, T_map_base = saved.stamps, saved.T_map_base
picture = plt.imread(output / "map.pgm")
yaml = dict(line.split(": ", 1) for line in (output / "map.yaml").read_text().splitlines())
resolution_m = float(yaml["resolution"])
x0, y0, _ = np.fromstring(yaml["origin"].strip("[]"), sep=",")
extent = (x0, x0 + resolution_m * picture.shape[1], y0, y0 + resolution_m * picture.shape[0])

figure, axes = plt.subplots(figsize=(7, 4.6), layout="constrained")
axes.imshow(picture, cmap="gray", vmin=0, vmax=255, extent=extent)
draw_path(axes, result.T_map_odom_base, "odometry")
draw_path(axes, T_map_base, "estimate")
axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
axes.legend()
plt.show()

# %% [markdown]
# ## Moving points and tracks
#
# `points.npz` has a label for each beam of each scan. `is_moving_online` is what was decided when the scan came;
# `is_moving` is the final label, which knows the whole run and usually finds a few more. With the
# trajectory, the ranges of the log give the points again.
#
# `tracks.csv` has a line for each moving object at each scan: where it was, how fast, and the covariance of the place.

# %%
labels = saved.points
assert labels is not None  # a folder of another program may lack them
moving = np.vstack(
    [
        scan.points(T)[is_moving]
        for scan, T, is_moving in zip(log, T_map_base, labels.is_moving & labels.is_valid, strict=True)
    ]
)
track_ids = saved.tracks[:, 1]

figure, axes = plt.subplots(1, 2, figsize=(11, 4), layout="constrained", sharex=True, sharey=True)
for panel in axes:
    draw_map(panel, result.grid, extent)
    panel.set(xlabel="x [m]", ylabel="y [m]")
axes[0].plot(*moving.T, ",", color="tab:red")
axes[0].set(title="moving points")
for track_id in np.unique(track_ids):
    axes[1].plot(*saved.tracks[track_ids == track_id, 2:4].T, linewidth=1)
axes[1].set(title=f"{len(np.unique(track_ids))} tracks")
plt.show()

# %% [markdown]
# There may be more tracks than people: who was out of sight for a while gets a new number.

# %%
figure, axes = plt.subplots(figsize=(8, 3), layout="constrained")
n_final, n_online = ((m & labels.is_valid).sum(axis=1) for m in (labels.is_moving, labels.is_moving_online))
axes.plot(labels.stamps, n_final, label="final", color="tab:orange", linewidth=2.5)
axes.plot(labels.stamps, n_online, label="as decided at the time", color="tab:blue", linewidth=0.8)
axes.set(xlabel="time [s]", ylabel="moving points in the scan")
axes.legend()
plt.show()

# %% [markdown]
# ## How sure is it?
#
# `covariances.npz` holds a 3 x 3 matrix for each pose, in the order x, y, heading, in the axes of the robot (x is
# forward). The roots of the diagonal are standard deviations. They are relative to where the run began, so they start
# at zero and grow along the path; a loop closure brings them down again. They are optimistic about errors that
# neighbouring scans share (see the README's limits).

# %%
assert saved.cov_map is not None
std = np.sqrt(np.diagonal(saved.cov_map, axis1=1, axis2=2))
figure, axes = plt.subplots(1, 2, figsize=(10, 3), layout="constrained")
axes[0].plot(stamps, 1000 * std[:, :2], label=["forward", "sideways"])
axes[0].set(xlabel="time [s]", ylabel="std of the position [mm]")
axes[0].legend()
axes[1].plot(stamps, np.degrees(std[:, 2]))
axes[1].set(xlabel="time [s]", ylabel="std of the heading [degrees]")
plt.show()

# %%
temporary.cleanup()
