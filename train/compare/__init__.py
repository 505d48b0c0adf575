"""Optimizers beside each other at equal numbers of roll-outs."""
