"""What is wrong in a record: lost counts, velocity steps."""
