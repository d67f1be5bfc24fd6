"""Filters and smoothers of integrated Wiener processes."""
