"""What an answer is worth: identifiability, residuals, coverage."""
