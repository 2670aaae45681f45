"""Stages without their imports: a warm server has imported what stages import, and a stage is forked from it."""
