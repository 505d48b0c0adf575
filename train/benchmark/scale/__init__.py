"""What roll-outs over many processes cost: measured with few, simulated with many."""
