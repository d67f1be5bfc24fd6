"""The ``daq`` command."""
