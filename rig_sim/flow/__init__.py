"""The equation of motion: its numbers, its frame, the modes of the contact and the transitions between them."""
