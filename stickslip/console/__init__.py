"""The command line: how commands start and end, flags, errors, progress; and the command `stickslip`."""
