"""Each claim of the paper as a rule that judges what was measured."""
