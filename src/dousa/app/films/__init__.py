"""The films of one scene: their keypoints, times and cameras."""
