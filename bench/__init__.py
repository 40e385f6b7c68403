"""Measures Parhelion, beside other renderers where they are installed: `python -m bench`."""
