"""Whatever searches for a better policy, behind one interface."""
