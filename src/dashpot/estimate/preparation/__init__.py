"""What is done to the data before any method sees them."""
