"""League of real robots: ``cellapp trials league``."""
