"""Which points move: ellipse test, visibility check, clusters, their probability, and the backward pass over a run.

A detector gets a scan, a pose with its covariance and the grid, and labels beams; it moves no pose and no map.
Imports `core`, `mapping`, `odometry` (constant R_r) and `tracking` (the backward pass follows tracks).
"""
