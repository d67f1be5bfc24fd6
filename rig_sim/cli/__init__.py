"""The command line `rig-sim`."""
