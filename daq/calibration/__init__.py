"""What a careful lab measures of its rig: ring-down, metres per count, datum, and a test of the board."""
