"""The dynamical system of the paper beside a dynamic movement primitive."""
