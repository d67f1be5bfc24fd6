"""Whether a law describes a record at all: goodness of fit against the record's own noise."""
