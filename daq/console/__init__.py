"""How every command meets a person: arguments, settings, units, errors, progress."""
