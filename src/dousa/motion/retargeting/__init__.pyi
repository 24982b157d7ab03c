from .contacts import find_contacts
from .retarget import LimbError, Retargeted, measure_directions, measure_skating, retarget

__all__ = ["LimbError", "Retargeted", "find_contacts", "measure_directions", "measure_skating", "retarget"]
