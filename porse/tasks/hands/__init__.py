"""What the two-hand tasks share: the Shadow Hands, scenes of tables and doors, and the bases of their classes."""
