"""Arms over many runs: what is read of each run, what has changed since the first, where a trend leads."""
