"""Whether a law describes a record at all: goodness of fit against the noise of the record."""
