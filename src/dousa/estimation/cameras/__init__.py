"""Cameras and calibration files."""
