"""`python -m train benchmark`: how fast everything is, beside a program that does nothing else."""
