"""Work that many machines do together: portions of it go to a cluster of workers, and answers come back in order.

``with use_cluster("tcp://scheduler:8786"):`` around ``Library.add``, ``Library.train`` or an experiment.
"""

from __future__ import annotations

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
