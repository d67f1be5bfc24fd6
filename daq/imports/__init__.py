"""Runs from elsewhere: tables of tracks, .mat files, logic captures, earlier runs."""
