"""Method of multipliers with semismooth Newton steps: penalties other than squares.

See docs/method.md, Penalties other than squares.
"""
