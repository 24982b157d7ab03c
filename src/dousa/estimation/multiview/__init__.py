"""From keypoints in several views to poses: sides put right, triangulation, a body fitted over the whole film."""
