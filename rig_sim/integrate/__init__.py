"""Exact motion between events: one scalar kernel source, interpreted for a single run, compiled for many."""
