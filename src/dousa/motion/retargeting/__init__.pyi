from .contacts import find_contacts
from .retarget import Retargeted, measure_directions, measure_skating, retarget

__all__ = ["Retargeted", "find_contacts", "measure_directions", "measure_skating", "retarget"]
