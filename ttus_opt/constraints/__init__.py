"""Constraints of a problem: one file per member, found by a formulation's import."""
