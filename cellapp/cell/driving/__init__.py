"""Every motion and every measured test: the engine that moves, settles, measures, logs, recovers and pauses."""
