"""The temporal filter: what a mosaic shares with the frames before it, before the table (docs/method.md#temporal)."""
