"""From silhouettes to poses: the start, the search frame after frame, and what is said of trust."""
