"""The motion of a scene, played and written to a file."""
