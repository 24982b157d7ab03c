"""What all requests share: the library with its clips and figures, motions by name, evaluations, corrections, and
estimations while they run."""
