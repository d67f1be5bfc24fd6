"""Faults of a record: spikes, frozen stretches, lost counts and frames, velocity steps."""
