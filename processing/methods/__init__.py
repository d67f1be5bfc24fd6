"""The velocity methods behind one signature, and the choice of their window."""
