"""Least-squares polynomials on arrays alone."""
