"""The command line of all four packages: arguments, settings, units, errors, progress."""
