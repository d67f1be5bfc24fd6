"""Nonlinear least squares with unknowns that all cycles share and unknowns that each cycle has of its own."""
