"""Trials in a web page: scenes of MuJoCo, arms and motions, with a time slider and plots (extra "view")."""
