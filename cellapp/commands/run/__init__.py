"""The verb ``run``: all verbs one after the other, unattended."""
