"""Uncertainty of fields and wrenches, and where to press next."""
