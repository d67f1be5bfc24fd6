"""Positions of a model and their derivatives."""
