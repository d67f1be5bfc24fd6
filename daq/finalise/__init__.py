"""From a journal to a run: one time axis, unwrapped counts, clocks, events, quality."""
