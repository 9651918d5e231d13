"""The weights of a fit, chosen from its recordings."""
