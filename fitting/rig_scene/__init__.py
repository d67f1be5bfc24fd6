"""The fitted rig as a scene of the simulator: its numbers, and the file."""
