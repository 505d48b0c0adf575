"""A learning run: the learner, its folder, its figures."""
