"""Over: the right hand throws an egg, and the left hand catches it. Both hands are fixed, palms up, face to face."""

from porse.tasks.over.task import Over

__all__ = ["Over"]
