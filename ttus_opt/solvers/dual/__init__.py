"""Eq. 10 through its dual: what the structured solver is made of.

From top to bottom: `active_set` goes from face to face (`face`, `spoke_limits`),
`few_columns` adds unknowns beside the field; each solves duals by `solver`, with
`conjugate_directions` on the exact operator (`system`), preconditioned by `rough`.
`data` reads the dual off a program.
"""
