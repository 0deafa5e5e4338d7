"""Tracks of moving objects: association of clusters, a constant-velocity filter, smoothing.

A tracker gets clusters in the local frame and hands out tracks; it does not know who found the clusters.
Imports `core` only.
"""
