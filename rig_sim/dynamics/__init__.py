"""Questions about a system's dynamics, one a file."""
