"""viz/rerun."""
