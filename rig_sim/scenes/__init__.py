"""Scenes: TOML files that name which terms exist."""
