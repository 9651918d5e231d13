"""`ttus_opt.contact.scene` by a name that scripts beside the project still use."""

from ttus_opt.contact.scene import Scene as Scene
from ttus_opt.contact.scene import ScenePlan as ScenePlan
