"""One way to fit: a friction curve, free shared unknowns and forces to windows of runs, by exact tangents."""
