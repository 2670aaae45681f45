"""FrankaCabinet: a Panda arm pulls the top drawer of a cabinet open."""

from porse.tasks.franka_cabinet.task import FrankaCabinet

__all__ = ["FrankaCabinet"]
