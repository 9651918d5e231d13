"""Solvers: one file per backend, each with a list ``SOLVERS``; see `registry`."""
