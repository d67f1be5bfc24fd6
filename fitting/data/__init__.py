"""A run as the fit sees it: frame, belt, cycles, ripple."""
