"""``python -m cellapp``."""

from cellapp.interfaces.cli import main

if __name__ == "__main__":
    main()
