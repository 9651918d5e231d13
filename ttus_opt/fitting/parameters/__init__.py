"""Parameters beside the field: search, standard errors, identifiability."""
