"""``python -m cellapp``."""

from cellapp.cli import main

if __name__ == "__main__":
    main()
