"""The paper's figures and claims, section by section: measured, drawn, judged."""
