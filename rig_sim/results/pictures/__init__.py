"""Pictures of analyses; matplotlib is imported here."""
