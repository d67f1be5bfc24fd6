"""The record in the frame of the fit, cut into cycles."""
