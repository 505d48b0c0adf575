"""What figures and claims measure; nothing is drawn or judged here."""
