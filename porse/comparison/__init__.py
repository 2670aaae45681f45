"""Many finished runs beside each other: tables in the paper's forms, and the page of results; and the command `porse report`."""
