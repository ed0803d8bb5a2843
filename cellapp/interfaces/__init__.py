"""How people and programs reach a verb: command line, terminal application, page, Python."""
