"""From a depth scan of the patient to the surface radius r(θ, z) (eqs. 1-5)."""
