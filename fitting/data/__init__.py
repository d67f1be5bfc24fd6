"""A run in the form the fit uses: frame, belt, cycles, ripple."""
