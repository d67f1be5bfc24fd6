"""Which laws describe the record."""
