"""Baselines: other packages behind the interface of `Pipeline`, to compare with; the only importers of them.

May import `core`, `mapping`, `odometry` and the result types of `detection` and `localization`.
Internal: a user reaches them by the names of `methods`.
"""
