"""The LASA benchmark: 26 motions with and without stability, beside published numbers."""
