"""Pose estimation from silhouettes: the start, the search frame by frame, the diagnosis."""
