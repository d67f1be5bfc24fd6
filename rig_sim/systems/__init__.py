"""What a system is to the analyses, and those of the rig: one mass, a driven one, two; a formula of one's own."""
