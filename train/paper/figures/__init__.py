"""The paper's figures, drawn from what was measured."""
