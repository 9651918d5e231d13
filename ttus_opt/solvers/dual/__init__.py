"""Eq. 10 through its dual: what the structured solver is made of.

From top to bottom: `exchange` goes from face to face (`activity`, `face_walk`,
`optimality`) of one field (`field_faces`, `face`, `spoke_limits`) or of two
(`field_pair`, `pair_face`, `pair_laplace`); `few_columns` adds unknowns beside the
fields; each solves duals by `solver` (`bordered` with one unknown more), with
`conjugate_directions` on the exact operator (`system`), preconditioned by `rough`.
`data` reads the dual off a program.
"""
