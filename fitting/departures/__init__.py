"""Departures from the assumptions that the six laws share: which one breaks, and by how much."""
