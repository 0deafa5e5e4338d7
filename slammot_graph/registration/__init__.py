"""Registration: a scan matched to a local map (point to line) or to the scan before (point to point).

A matcher hands out a pose, its covariance in parts and a status; a failed match is never an identity transform.
Imports `core` and `mapping`.
"""
