"""The problems as the paper's authors released them."""
