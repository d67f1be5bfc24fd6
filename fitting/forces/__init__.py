"""Departures as forces, and the fitted motion that they read."""
