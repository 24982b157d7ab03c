"""Silhouettes from videos, images and npz files, their cleaning and repair."""
