"""Temporal filter: blends each raw frame with the previous frames before rendering (docs/method.md#temporal)."""
