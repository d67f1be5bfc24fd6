"""Bytes to samples without any input or output: frames, counters, quadrature."""
