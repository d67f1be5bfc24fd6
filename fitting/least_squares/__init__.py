"""Nonlinear least squares with unknowns shared by all cycles and unknowns of each cycle."""
