"""The rig as maps: one mass from slip to slip, two from stick to stick, a driven one from section to section."""
