"""From two motions to an assessment with a grade."""
