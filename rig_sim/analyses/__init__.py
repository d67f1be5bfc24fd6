"""What is asked of any system: attractors, basins, exponents, periodic orbits, branches and sweeps."""
