"""Silhouettes: from masks, images and films to one mask a view and frame."""
