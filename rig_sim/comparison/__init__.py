"""Other integrators, and error against run time."""
