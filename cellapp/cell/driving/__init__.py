"""Motions and measured tests: the engine that moves, settles, measures, logs, recovers and pauses."""
