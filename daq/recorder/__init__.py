"""The recorder: port, reading thread, journal."""
