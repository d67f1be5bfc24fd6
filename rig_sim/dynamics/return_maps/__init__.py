"""Return maps of the rig: one mass from slip to slip, two from stick to stick, a driven one between its sections."""
