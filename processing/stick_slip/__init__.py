"""Stick and slip: switching times, and the smoother with a model of each."""
