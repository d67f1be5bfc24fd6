"""Driven systems: sections, the period of an attractor in drive periods, exponents, sweeps, and dither."""
