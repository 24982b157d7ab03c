"""The motion forest: growing, prediction, storage, new categories, and calibration."""
