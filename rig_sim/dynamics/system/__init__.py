"""What a system is to the analyses: maps from one passage of a section to the next, their periods and their steps."""
