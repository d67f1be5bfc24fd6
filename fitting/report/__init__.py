"""The report and the stored fit."""
