"""Verdict and warnings in words."""
