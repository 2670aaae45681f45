"""Physics behind one small interface, and the rotation arithmetic that tasks share. Knows nothing of any task."""
