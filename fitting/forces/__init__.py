"""What a departure is, and the fitted motion that it reads."""
