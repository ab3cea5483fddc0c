"""What the documentation site computes while it is built; `docs/conf.py` calls it."""
