"""The declared problem: formulation, program (matrices), solution."""
