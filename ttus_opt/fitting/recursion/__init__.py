"""Eq. 10 one measurement at a time."""
