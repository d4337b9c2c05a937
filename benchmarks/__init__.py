"""Measurements of speed, as ratios and phases in one run; never a timed test."""
