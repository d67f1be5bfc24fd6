"""Dry friction: six laws, each one slip curve and one contact; the simulator and the fits share this definition."""
