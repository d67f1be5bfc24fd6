"""Limit cycles of one undriven mass, its fixed point, their multipliers and their branches over a parameter."""
