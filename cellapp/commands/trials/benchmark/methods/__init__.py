"""Methods of the benchmark: one file and one line in ``registry`` each, or a plug-in."""
