from .cluster import Cluster
from .current import current_cluster, use_cluster

__all__ = ["Cluster", "current_cluster", "use_cluster"]
