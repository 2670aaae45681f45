"""What is asked of the model, in which words, and what becomes of its replies."""
