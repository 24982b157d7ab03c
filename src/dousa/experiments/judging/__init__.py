"""Material, labels, training and trials of the learned judge of `dousa.evaluation`."""
