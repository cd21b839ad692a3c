"""What can be known, how well, and what the model gets wrong."""
