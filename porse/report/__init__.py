"""What a run tells people: tables over all iterations, metrics, plots."""
