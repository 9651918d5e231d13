"""Method of multipliers with semismooth Newton steps: penalties other than squares.

See docs/method/solver-variants.md, Penalties other than squares.
"""
