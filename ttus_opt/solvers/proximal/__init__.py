"""Method of multipliers with semismooth Newton steps: penalties that are no squares.

See docs/method.md, Penalties that are no squares.
"""
