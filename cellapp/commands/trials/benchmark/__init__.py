"""The benchmark "name the missing effect": sealed problems, a scorer, and methods that anybody can add."""
