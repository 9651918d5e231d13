"""Terms of an objective: one file per member, found by a formulation's import."""
