"""One-dimensional maps: the map of two masses from stick to stick, and what any map of an interval is asked."""
