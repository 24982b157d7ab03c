"""What pictures and pages draw with the same code: bodies, axes and marks."""
