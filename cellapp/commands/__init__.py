"""The verbs: each folder is one, with what it does, its result and how that is shown."""
