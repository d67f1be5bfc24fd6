"""The measured friction curve: a spline fitted to the trajectories, its band."""
