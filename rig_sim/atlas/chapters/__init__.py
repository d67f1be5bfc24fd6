"""What the figures of each chapter show: a file a chapter; the computing is done by the analyses that it calls."""
