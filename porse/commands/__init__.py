"""Commands about the project itself: what there is, how it runs, and what came out."""
