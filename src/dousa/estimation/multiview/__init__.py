"""Poses from keypoints in several views: sides, triangulation, and a body fitted over the whole film."""
