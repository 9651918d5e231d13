"""Fitting a field: at once, one measurement at a time, and identified parameters."""
