"""What goes beyond the paper's learner, measured against it."""
