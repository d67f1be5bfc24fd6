"""One undriven mass: its fixed point, its periodic orbits with multipliers, their branches over a parameter."""
