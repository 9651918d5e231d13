"""A simulated torso: independent physics that generates the bundled example.

A linear-elastic finite-element body with ribs and a lump is pressed by a rigid probe in
unilateral contact, with optional Coulomb drag and sensor noise. The simulation does not
use potential fields, so fitting one to its recordings is a real test. "Skin" is the
outer layer of nodes, which deforms; "surface" is what a scan of it yields.
"""
