"""Access to the verbs for people and programs: command line, terminal application, page, Python."""
