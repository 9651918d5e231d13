"""Gaussian fields, and what measurements say of them."""
