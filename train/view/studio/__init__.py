"""A local web page on which motions are drawn, imitated, improved by trial, and pushed."""
