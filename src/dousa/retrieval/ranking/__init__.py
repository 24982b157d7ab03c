"""The order of answers: by histograms, leaves and poses; and the motion templates that are the baseline."""
