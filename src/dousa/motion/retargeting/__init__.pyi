from .contacts import find_contacts as find_contacts
from .retarget import LimbError as LimbError
from .retarget import Retargeted as Retargeted
from .retarget import measure_directions as measure_directions
from .retarget import measure_skating as measure_skating
from .retarget import retarget as retarget
