"""Penalties of a residual: one file each, with all that solvers and checks ask."""
