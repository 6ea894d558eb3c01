"""Measured figures; each script prints what docs/performance.md quotes."""
