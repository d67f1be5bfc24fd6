"""Least squares for windows of a record."""
