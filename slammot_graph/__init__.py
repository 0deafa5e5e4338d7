"""Simultaneous localization, mapping and moving object tracking with a 2D laser, on a factor graph."""
