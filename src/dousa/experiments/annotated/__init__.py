"""The trial of real annotated takes: people left out in turn, and what is right."""
