from .cluster import Cluster as Cluster
from .current import current_cluster as current_cluster
from .current import use_cluster as use_cluster
