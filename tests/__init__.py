"""Tests; whatever their processes import is compiled once, not by each of hundreds of them."""

import os
import sys

sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
