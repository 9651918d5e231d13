"""A simulated torso: independent physics that generates the bundled example.

A linear-elastic finite-element body with ribs and a lump is pressed by a rigid probe in
unilateral contact, with optional Coulomb drag and sensor noise. The simulation does not
use potential fields, so fitting one to its recordings is a real test. "Skin" is the
outer layer of nodes, which deforms; "surface" is what a scan of it yields.
"""

from ttus_opt.phantom.elasticity import ElasticBody, SkinPatch, skin_compliance
from ttus_opt.phantom.press import Contact, CoulombDrag, Motion, press
from ttus_opt.phantom.probe import EllipsoidProbe
from ttus_opt.phantom.recording import add_noise, record
from ttus_opt.phantom.torso import Torso, TorsoMesh, torso_body

__all__ = [
    "Contact",
    "CoulombDrag",
    "ElasticBody",
    "EllipsoidProbe",
    "Motion",
    "SkinPatch",
    "Torso",
    "TorsoMesh",
    "add_noise",
    "press",
    "record",
    "skin_compliance",
    "torso_body",
]
