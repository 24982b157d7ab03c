"""Advice: what a learner should do differently, in a teacher's words: limb, direction, amount and moment."""
