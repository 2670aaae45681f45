"""SwingCup: two hands hold a cup by its two handles and turn it around."""

from porse.tasks.swing_cup.task import SwingCup

__all__ = ["SwingCup"]
