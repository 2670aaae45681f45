"""`porse report`: one page about a run, with a film of its winner, or many runs beside each other in the paper's forms."""
