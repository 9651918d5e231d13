"""Paths of weights: one formulation solved for many weights."""
