"""How laws are fitted."""
