"""A compliant point mass in a force field: motion and stiffness are learned together (section 5.4)."""
