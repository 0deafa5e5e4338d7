"""Maps: the occupancy grid of the moving-point test and of the output, and the local map that scans are matched to.

Each class keeps its arrays, the kernels beside it work on them; where the robot is comes from the caller.
Imports `core` only.
"""
