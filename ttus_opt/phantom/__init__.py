"""A simulated torso: an independent physics that makes the bundled example.

A linear-elastic finite-element body with ribs and a lump, pressed by a rigid probe
through unilateral contact on its skin's compliance, with optional Coulomb drag and
sensor noise. It knows nothing of potential fields, so that fitting one to its
recordings proves something. "Skin" is its outer layer of nodes, which deforms; what
a scan of it gives is a surface.
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
