"""Verdicts: KKT residuals, bounds of the gap, certificates."""
