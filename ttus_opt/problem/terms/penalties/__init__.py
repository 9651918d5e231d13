"""Penalties of a residual, one file each."""
