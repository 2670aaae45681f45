"""The search over candidates: pure functions over tables. Trains nothing and asks nobody."""
