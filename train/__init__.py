"""Training commands: python -m train <task> [options]."""
