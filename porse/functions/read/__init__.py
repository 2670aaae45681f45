"""From a reply to an operator list and a verdict: extraction, the static check, the trace and the trial. Validation alone needs it."""
