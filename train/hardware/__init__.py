"""Learning with a real robot, through files."""
