"""PoRSE: policy-grounded synergy of reward shaping and exploration, replayable without a network."""

__version__ = "0.1.0"
