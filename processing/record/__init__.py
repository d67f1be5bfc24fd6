"""What is smoothed and what comes out."""
