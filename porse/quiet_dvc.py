"""DVC as `porse repro` runs it: it says what went wrong in DVC itself, and nothing else. Run as a script, and never imported.

`dvc --quiet` is silent about its own errors, too. A stage that fails has said why by itself.
"""

import logging
import sys

from dvc.cli import main
from dvc.stage.exceptions import StageCmdFailedError
from dvc.ui import ui


class _Own(logging.Filter):
    """Lets errors of DVC itself pass, and neither those of a stage nor Ctrl-C."""

    def filter(self, record: logging.LogRecord) -> bool:
        error = record.exc_info[1] if record.exc_info else None
        while error is not None:
            if isinstance(error, StageCmdFailedError | KeyboardInterrupt):
                return False
            error = error.__cause__
        return True


if __name__ == "__main__":
    for name in ("dvc", "dvc_objects", "dvc_data"):
        logger = logging.getLogger(name)
        logger.setLevel(logging.ERROR)
        for handler in logger.handlers:
            handler.addFilter(_Own())
    # Its progress bars look at this logger's level.
    logging.getLogger("dvc.progress").setLevel(logging.CRITICAL)
    # What it says about work that is done; errors are forced past it.
    ui.enable = lambda: None
    sys.exit(main(sys.argv[1:]))
