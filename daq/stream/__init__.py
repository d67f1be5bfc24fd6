"""One forward pass over what boards sent: connections, one time axis, counts that are checked, clocks."""
