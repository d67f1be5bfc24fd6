"""Estimating a law's parameters from a run, with their covariance."""
