"""The simulated board: encoders, what is lost between mass and counter, and the wire."""
